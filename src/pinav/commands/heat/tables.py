"""Tables of `pinav heat`, for terminal and report alike."""

from pinav.commands.heat.metrics import (
    ForecastMetrics,
    HeatMetrics,
    JudgedMetrics,
    LearnMetrics,
    OptimumMetrics,
    RunMetrics,
)
from pinav.report import Table
from pinav.report.text import as_text

SYNTHETIC = "Synthetic data of a research code."


def run_table(metrics: RunMetrics) -> Table:
    """Temperatures and doses of a run."""
    reached = metrics.time_to_therapy
    rows: list[tuple[str, str | float]] = [
        ("highest temperature [°C]", metrics.highest),
        ("end of heating [min]", metrics.heated / 60),
        ("T10 of the tumour at the end of heating [°C]", metrics.t10),
        ("T50 of the tumour at the end of heating [°C]", metrics.t50),
        ("T90 of the tumour at the end of heating [°C]", metrics.t90),
        ("fraction of the tumour above 43 °C then", metrics.v43),
        ("D90 of the tumour [CEM43 min]", metrics.d90),
        (
            "D90 reaches 10 CEM43 min after [min]",
            "never" if reached is None else reached / 60,
        ),
        ("CEM43 T90 of the tumour [min]", metrics.t90_dose),
        ("largest dose outside the tumour [CEM43 min]", metrics.healthy_dose),
        ("largest product Hf [A/(m s)]", metrics.hf),
        ("relative error of the energy balance", metrics.imbalance),
    ]
    if metrics.dead_target is not None and metrics.dead_outside is not None:
        rows.append(("dead fraction of the tumour (Arrhenius)", metrics.dead_target))
        name = "largest dead fraction outside the tumour (Arrhenius)"
        rows.append((name, metrics.dead_outside))
    return Table(("quantity", "value"), rows, SYNTHETIC)


def constraint_table(metrics: OptimumMetrics) -> Table:
    """The constraints of an optimisation."""
    rows = [
        (
            f"{constraint.name} [{constraint.unit}]",
            constraint.value,
            constraint.bound,
            "active" if constraint.active else "not reached",
        )
        for constraint in metrics.constraints
    ]
    return Table(("constraint", "value", "bound", "at the optimum"), rows)


def judgement_table(judged: JudgedMetrics) -> Table:
    """A plan on the true tissue."""
    rows: list[tuple[str, str | float]] = [
        ("D90 of the tumour [CEM43 min]", judged.d90),
        ("D90 of a plan made with the truth [CEM43 min]", judged.best_d90),
        ("highest temperature [°C]", judged.highest),
    ]
    return Table(("the plan on the true tissue", "value"), rows)


def fit_table(metrics: LearnMetrics) -> Table:
    """How well a fit explains the probes."""
    unit = "of its map" if metrics.relative else "[K]"
    rows: list[tuple[str, str | float]] = [
        (f"residual, root mean square {unit}", metrics.residual),
        (f"noise, estimated {unit}", metrics.noise),
        ("steps", metrics.iterations),
    ]
    for name, law in metrics.laws.items():
        low, high = law.visited
        rows.append((f"perfusion of {name}: visited [°C]", f"{low:.1f} to {high:.1f}"))
        if law.covered is not None:
            label = f"perfusion of {name}: coverage of the 95 % band"
            rows.append((label, law.covered))
    if not metrics.quantities:
        for name, number in metrics.constants.items():
            rows.append((name, f"{number.value:.5g} ± {number.sd:.2g}"))
    for row in metrics.quantities:
        true = "" if row.true is None else f"; true {row.true:.5g}"
        rows.append((row.name, f"{row.value:.5g} ± {row.sd:.2g}{true}"))
    if metrics.laws:
        name = f"residual of the best constant perfusion {unit}"
        rows.append((name, metrics.constant_residual))
    rows += _forecast_rows(metrics.forecast, unit)
    for row in metrics.held_out:
        name = f"largest error at power {row.power:g}, not fitted [K]"
        rows.append((name, row.learned))
        rows.append((f"{name}, constant perfusion", row.constant))
    return Table(("quantity", "value"), rows, SYNTHETIC)


def _forecast_rows(
    forecast: ForecastMetrics | None, unit: str
) -> list[tuple[str, str | float]]:
    if forecast is None:
        return []
    rows: list[tuple[str, str | float]] = [
        ("fitted until [min]", forecast.fitted_until / 60),
        ("later: largest standard deviation of the target [K]", forecast.sd),
    ]
    if forecast.residual is not None:
        rows.append((f"later: residual {unit}", forecast.residual))
    if forecast.error is not None and forecast.covered is not None:
        rows.append(("later: largest error of the target [K]", forecast.error))
        rows.append(("later: truth in the 95 % band", forecast.covered))
    return rows


def text(metrics: HeatMetrics) -> str:
    """The results of a task for a terminal."""
    if isinstance(metrics, LearnMetrics):
        return as_text(fit_table(metrics))
    if isinstance(metrics, RunMetrics):
        return "\n".join([as_text(run_table(metrics)), *_warnings(metrics)])
    line = f"D90 {metrics.result.d90:.3g} min, from {metrics.start_d90:.3g} min"
    return "\n".join(
        [
            as_text(run_table(metrics.result)),
            as_text(constraint_table(metrics)),
            *([as_text(judgement_table(metrics.judged))] if metrics.judged else []),
            f"{line} at the flat start; {metrics.outcome}",
            *_warnings(metrics.result),
        ]
    )


def _warnings(metrics: RunMetrics) -> list[str]:
    return [f"warning: {line}" for line in metrics.warnings]
