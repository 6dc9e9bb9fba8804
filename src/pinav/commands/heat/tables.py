"""Tables of `pinav heat`, for terminal and report alike."""

from typing import Any

from pinav.report import Table
from pinav.report.text import as_text
from pinav.thermal.verification import Check

OUTCOMES = {
    "T_max": "highest temperature [°C]",
    "T10": "T10 of the tumour at the end [°C]",
    "T50": "T50",
    "T90": "T90",
    "D90": "D90 of the tumour [CEM43 min]",
    "V43": "share of the tumour above 43 °C at the end",
    "healthy_dose": "largest dose outside the tumour [CEM43 min]",
    "Hf": "largest product Hf [A/(m s)]",
    "imbalance": "heat that is not accounted for, relative",
}


def outcome_table(metrics: dict[str, Any]) -> Table:
    """What a run reached."""
    rows = [(label, metrics[name]) for name, label in OUTCOMES.items()]
    return Table(("quantity", "value"), rows, SYNTHETIC)


SYNTHETIC = "Synthetic data of a research code."


def constraint_table(metrics: dict[str, Any]) -> Table:
    """The constraints of an optimisation."""
    rows = [
        (
            f"{own['name']} [{own['unit']}]",
            own["value"],
            own["bound"],
            "active" if own["active"] else "not reached",
        )
        for own in metrics["constraints"]
    ]
    return Table(("constraint", "value", "bound", "at the optimum"), rows)


def fit_table(metrics: dict[str, Any]) -> Table:
    """How well a fit explains the probes."""
    rows: list[tuple] = [
        ("residual, root mean square [K]", metrics["residual"]),
        ("noise, estimated [K]", metrics["noise"]),
        ("steps", metrics["iterations"]),
    ]
    for name, law in metrics.get("laws", {}).items():
        low, high = law["visited"]
        rows.append((f"perfusion of {name}: visited [°C]", f"{low:.1f} to {high:.1f}"))
        if "covered" in law:
            rows.append((f"perfusion of {name}: truth inside the band", law["covered"]))
    for name, own in metrics["constants"].items():
        rows.append((name, f"{own['value']:.5g} ± {own['sd']:.2g}"))
    baseline = metrics["constant"]["residual"]
    rows.append(("residual of the best constant perfusion [K]", baseline))
    for row in metrics.get("held_out", ()):
        name = f"largest error at power {row['power']:g}, not fitted [K]"
        rows.append((name, row["learned"]))
        rows.append((f"{name}, constant perfusion", row["constant"]))
    return Table(("quantity", "value"), rows, SYNTHETIC)


def validation_rows(checks: list[Check]) -> list[dict[str, Any]]:
    """The checks as they are printed for scripts."""
    return [
        {
            "case": own.case,
            "found": own.found,
            "exact": own.true,
            "error": own.error,
            "tolerance": own.tolerance,
            "unit": own.unit,
            "within": own.passed,
        }
        for own in checks
    ]


def validation_table(checks: list[Check]) -> Table:
    """Errors of the solver against exact solutions."""
    rows = [
        (
            f"{own.case} [{own.unit}]",
            own.found,
            own.true,
            f"{own.error:.1e}",
            f"{own.tolerance:.0e}",
            "yes" if own.passed else "NO",
        )
        for own in checks
    ]
    return Table(("case", "found", "exact", "error", "tolerance", "within"), rows)


def text(metrics: dict[str, Any]) -> str:
    """The results of a task for a terminal."""
    if metrics["task"] == "learn":
        return as_text(fit_table(metrics))
    parts = [as_text(outcome_table(metrics))]
    if metrics["task"] == "optimise":
        parts.append(as_text(constraint_table(metrics)))
        line = f"D90 {metrics['D90']:.3g} min, from {metrics['start_D90']:.3g} min"
        parts.append(f"{line} at the flat start; {metrics['outcome']}")
    parts += [f"doubtful: {line}" for line in metrics["doubts"]]
    return "\n".join(parts)
