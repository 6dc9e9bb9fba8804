"""Results of `pinav navigate` as rows, tables and words."""

from typing import Any

from pinav.navigation.trials.metrics import Interval, Summary
from pinav.report import Table
from pinav.report.text import as_text


def interval(found: Interval) -> dict[str, float]:
    """A value with its interval, as JSON."""
    return {"value": found.value, "lower": found.lower, "upper": found.upper}


def controller_row(found: Summary) -> dict[str, Any]:
    """Metrics of a controller, as JSON."""
    low, middle, high = found.arrival
    return {
        "runs": found.count,
        "success": interval(found.success),
        "violation": interval(found.violation),
        "arrival": {"low": low, "median": middle, "high": high},
        "efficiency": found.efficiency,
        "clearance": found.clearance,
        "effort": found.effort,
        "turning": found.turning,
    }


def controller_table(metrics: dict[str, Any]) -> Table:
    """One row for each controller."""
    rows = []
    for name, row in metrics["controllers"].items():
        ratio = metrics["regret"].get(name)
        rows.append(
            (
                name,
                _share(row["success"]),
                _share(row["violation"]),
                row["arrival"]["median"],
                "–" if ratio is None else _ratio(ratio),
                row["efficiency"],
                row["clearance"],
            )
        )
    header = (
        "controller",
        "success",
        "violation",
        "arrival",
        "regret",
        "efficiency",
        "least clearance",
    )
    runs = next(iter(metrics["controllers"].values()))["runs"]
    return Table(header, rows, f"{runs} runs each. {CAPTION}")


CAPTION = (
    "Success and violation with Wilson's 95 % interval; arrival: median time of those "
    "that arrived; regret: median over paired runs of the arrival time over that with "
    "the truth; efficiency: straight distance over length of the way."
)


def _share(found: dict[str, float]) -> str:
    value, lower, upper = (100 * found[k] for k in ("value", "lower", "upper"))
    return f"{value:.0f} % ({lower:.0f}–{upper:.0f})"


def _ratio(found: dict[str, float | None]) -> str:
    parts = [found[k] for k in ("value", "lower", "upper")]
    value, lower, upper = ("∞" if part is None else f"{part:.3f}" for part in parts)
    return f"{value} ({lower}–{upper})"


def sentences(metrics: dict[str, Any]) -> list[str]:
    """What was found, in words."""
    plan, step = metrics["plan"], metrics["step"]
    lines = [
        f"The plan takes {plan['time']:.3g} from rest; from "
        f"{plan['unreachable']:.0%} of the arena the goal cannot be reached in time.",
        f"Tried in {where(metrics)}.",
        f"A control step takes {1e3 * step['median']:.2g} ms, the first one "
        f"{step['first']:.2g} s with its compilation.",
    ]
    for name, reason in metrics["refused"].items():
        lines.append(f"No run with the model {name}: {reason}.")
    if "suggestion" in metrics:
        lines.append(_advice(metrics["suggestion"]))
    return lines


def where(metrics: dict[str, Any]) -> str:
    """The environment of the closed loops, in words."""
    if metrics["truth"] is None:
        return (
            "environments drawn from the posterior, or the model itself where there is "
            "none: the true one is not known"
        )
    return f"the true environment of scenario {metrics['truth']} (synthetic)"


def _advice(found: dict[str, Any]) -> str:
    text = (
        f"The next trajectory to record (suggestion.csv) should lower the standard "
        f"deviation of forces along the route from {found['sd']:.2g} to "
        f"{found['sd_after']:.2g}"
    )
    random = found["sd_after_random"]
    return text + ("." if random is None else f", a random one to {random:.2g}.")


def text(metrics: dict[str, Any]) -> str:
    """The findings for a terminal."""
    return "\n".join([as_text(controller_table(metrics)), *sentences(metrics)])
