"""The tables of an evaluation, the same on a terminal and in the report."""

from collections.abc import Callable

from pinav.commands.cells import Cell, percent
from pinav.commands.evaluate.metrics import (
    CalibrationRow,
    ConstantRow,
    EvaluationMetrics,
    ResidualRow,
)
from pinav.report import Table, capitalise, heading, quantity

BEYOND_DATA = (
    "In unvisited places a band rests on the assumed prior alone, which fades away "
    "from the data, while true forces need not: do not trust it there."
)
"""Limit of the bands."""


def tables(metrics: EvaluationMetrics) -> list[Table]:
    """Every table that the metrics of `pinav evaluate` have the content for."""
    content = [_errors(metrics), _rollouts(metrics)]
    if metrics.force:
        content.append(_force(metrics))
    if metrics.coverage:
        content.append(_coverage(metrics.coverage))
    if metrics.whiteness:
        content.append(_whiteness(metrics.whiteness))
    if metrics.constants:
        content.append(_constants(metrics.constants))
    if metrics.calibration is not None:
        content.append(_calibration(metrics.calibration))
    return content


def _errors(metrics: EvaluationMetrics) -> Table:
    units = {"position": metrics.unit} | metrics.units
    names = next(iter(metrics.rmse.values()))
    columns = [heading(name, units.get(name, "")) for name in names]
    rows = [(name, *row.values()) for name, row in metrics.rmse.items()]
    return Table(
        (f"RMSE, {metrics.error_name}", *columns),
        rows,
        f"Rollouts over {metrics.data}, {metrics.trajectories} trajectories; "
        f"starts: {metrics.starts}.",
    )


def _rollouts(metrics: EvaluationMetrics) -> Table:
    rows = [
        (
            f"{model}, {source}, {part}",
            row.median,
            row.high,
            percent(row.median_relative),
            percent(row.high_relative),
            percent(row.diverged),
            row.trajectories,
        )
        for model, sources in metrics.rollouts.items()
        for source, parts in sources.items()
        for part, row in parts.items()
    ]
    unit = metrics.unit
    header = ("position error of rollouts", heading("median", unit))
    header += (heading("90 %", unit),)
    header += ("median/path (%)", "90 %/path (%)", "diverged (%)", "trajectories")
    return Table(
        header,
        rows,
        "Root-mean-square position error of each trajectory: median and 90th "
        "percentile over trajectories, also over the length of the path. Diverged: not "
        f"finite, or farther off than the extent of the training data, "
        f"{quantity(metrics.domain, unit)}. The training horizon is "
        f"{quantity(metrics.horizon, metrics.units.get('t', ''))}. "
        "Clean starts are those of held-out trajectories of the system without "
        "observation noise.",
    )


def _force(metrics: EvaluationMetrics) -> Table:
    rows = [
        (
            f"{model}, {region}",
            percent(row.error),
            f"{row.cosine:.5f}" if isinstance(row.cosine, float) else "–",
            row.points,
        )
        for model, regions in metrics.force.items()
        for region, row in regions.items()
    ]
    return Table(
        ("force of", "relative L2 error (%)", "cosine", "grid points"),
        rows,
        "Against the truth of the system, on a grid around the training data, a "
        f"swimmer at rest. {capitalise(metrics.regions)}.",
    )


def _coverage(coverage: dict[str, dict[str, Cell]]) -> Table:
    rows = [
        (
            what,
            *(percent(row[region]) for region in ("visited", "near", "unvisited")),
        )
        for what, row in coverage.items()
    ]
    return Table(
        ("inside nominal 95 % bands (%)", "visited", "near", "unvisited"),
        rows,
        "Observations count the noise that the fit found; rollouts from clean starts "
        "and the force are compared with the truth itself. Regions are those of the "
        f"force table. {BEYOND_DATA}",
    )


def _whiteness(whiteness: dict[str, ResidualRow]) -> Table:
    lags = (1, 2, 5, 10)
    rows = [
        (
            name,
            row.residuals,
            *(row.autocorrelation[lag - 1] for lag in lags),
            row.statistic,
            row.p_value,
        )
        for name, row in whiteness.items()
    ]
    return Table(
        ("residuals of", "count", *(f"lag {k}" for k in lags), "Ljung-Box Q", "p"),
        rows,
        "Autocorrelation of the residuals of the fit on the training data, and Ljung "
        "and Box's test over lags 1 to 10: a small p says that they are not white, so "
        "that the model misses something. Without noise in the data the residuals are "
        "integration error, which is never white.",
    )


def _constants(constants: tuple[ConstantRow, ...]) -> Table:
    columns: dict[str, Callable[[ConstantRow], Cell]] = {
        "constant": lambda row: row.name,
        "true": lambda row: row.true,
        "recovered": lambda row: row.value,
        "sd": lambda row: row.sd,
        "error (%)": lambda row: percent(row.relative_error),
        "z": lambda row: row.z,
    }
    return Table.of(
        constants,
        columns,
        "Constants trained beside the force, against the truth of the system: an error "
        "that the force could compensate shows here; |z| above 2 or 3 says that the "
        "interval is too narrow.",
    )


def _calibration(band: CalibrationRow) -> Table:
    radius = "none" if band.radius == "diverged" else band.radius
    return Table(
        ("conformal band", "radius", "trajectories", "data inside (%)"),
        [(band.file, radius, band.count, 100 * band.covered)],
        f"Split-conformal, whole trajectories: {band.says}. The radius is in "
        f"{band.unit}. Inside: trajectories of the data that stay within the band "
        "at every scored sample.",
    )
