"""The tables of an evaluation, the same on a terminal and in the report."""

from typing import Any

from pinav.report import Table
from pinav.report.page import Cell


def tables(metrics: dict[str, Any]) -> list[Table]:
    """Every table that the metrics of `pinav evaluate` have the content for."""
    found = [_errors(metrics), _rollouts(metrics)]
    if metrics["force"]:
        found.append(_force(metrics))
    if metrics.get("coverage"):
        found.append(_coverage(metrics))
    if metrics.get("whiteness"):
        found.append(_whiteness(metrics))
    if metrics.get("constants"):
        found.append(_constants(metrics))
    if metrics.get("calibration"):
        found.append(_calibration(metrics))
    return found


def _errors(metrics) -> Table:
    columns = list(next(iter(metrics["rmse"].values())))
    rows = [(name, *row.values()) for name, row in metrics["rmse"].items()]
    return Table(
        ("RMSE of", *columns),
        rows,
        f"Rollouts over {metrics['data']}, {metrics['trajectories']} trajectories; "
        f"starts: {metrics['starts']}.",
    )


def _rollouts(metrics) -> Table:
    names = ("median", "high", "median_relative", "high_relative", "diverged")
    rows = [
        (f"{model}, {source}, {part}", *(_percent(row, n) for n in names), count)
        for model, sources in metrics["rollouts"].items()
        for source, parts in sources.items()
        for part, row in parts.items()
        for count in [row["trajectories"]]
    ]
    header = ("position error of rollouts", "median", "90 %")
    header += ("median/way (%)", "90 %/way (%)", "diverged (%)", "trajectories")
    return Table(
        header,
        rows,
        "Root-mean-square position error of each trajectory: median and 90th "
        "percentile over trajectories, also over the way travelled. Diverged: not "
        f"finite, or farther off than the extent of the training data, "
        f"{metrics['domain']:.3g}. The training horizon is {metrics['horizon']:.3g}. "
        "Clean starts are those of noise-free held-out trajectories of the scenario.",
    )


def _percent(row: dict[str, Any], name: str) -> Cell:
    value = row[name]
    absolute = name in ("median", "high") or not isinstance(value, float)
    return value if absolute else 100 * value


def _force(metrics) -> Table:
    rows = [
        (f"{model}, {region}", _hundred(row["error"]), _cosine(row), row["points"])
        for model, regions in metrics["force"].items()
        for region, row in regions.items()
    ]
    return Table(
        ("force of", "relative L2 error (%)", "cosine", "grid points"),
        rows,
        "Against the truth of the scenario, on a grid around the training data, a "
        f"swimmer at rest. {metrics['regions'].capitalize()}.",
    )


def _cosine(row: dict[str, Any]) -> str:
    return "–" if row["cosine"] is None else f"{row['cosine']:.5f}"


def _hundred(value: float | None | str) -> Cell:
    return 100 * value if isinstance(value, float) else value


def _coverage(metrics) -> Table:
    rows = [
        (what, *(_hundred(row[region]) for region in ("visited", "near", "unvisited")))
        for what, row in metrics["coverage"].items()
    ]
    return Table(
        ("inside nominal 95 % bands (%)", "visited", "near", "unvisited"),
        rows,
        "Observations count the noise that the fit found; rollouts from clean starts "
        "and the force are compared with the truth itself. Regions are those of the "
        "force table.",
    )


def _whiteness(metrics) -> Table:
    lags = (1, 2, 5, 10)
    rows = [
        (
            name,
            row["residuals"],
            *(row["autocorrelation"][lag - 1] for lag in lags),
            row["statistic"],
            row["p_value"],
        )
        for name, row in metrics["whiteness"].items()
    ]
    return Table(
        ("residuals of", "count", *(f"lag {k}" for k in lags), "Ljung-Box Q", "p"),
        rows,
        "Autocorrelation of the residuals of the fit, and Ljung and Box's test over "
        "lags 1 to 10: a small p says that they are not white. Without noise in the "
        "data residuals are those of the integrator and the model, never white.",
    )


def _constants(metrics) -> Table:
    rows = [
        (
            row["name"],
            row["true"],
            row["value"],
            row["sd"],
            _hundred(row["relative_error"]),
            row["z"],
        )
        for row in metrics["constants"]
    ]
    return Table(
        ("constant", "true", "recovered", "sd", "error (%)", "z"),
        rows,
        "Constants trained beside the force, against the scenario's truth: what leaks "
        "between them and the force shows here; |z| above 2 or 3 says that the "
        "interval is too narrow.",
    )


def _calibration(metrics) -> Table:
    found = metrics["calibration"]
    radius = "none" if found["radius"] == "diverged" else found["radius"]
    return Table(
        ("conformal band", "radius", "trajectories", "data inside (%)"),
        [(found["file"], radius, found["count"], 100 * found["covered"])],
        f"Split-conformal, whole trajectories: {found['says']}. The radius is in "
        f"{found['unit']}. Inside: trajectories of the data that stay within the band "
        "at every scored sample.",
    )
