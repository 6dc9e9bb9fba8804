"""The section of a report that an evaluation fills."""

import numpy as np

from pinav.commands.evaluate.tables import tables
from pinav.evaluation import ErrorCurve
from pinav.figures import save_figure
from pinav.figures.errors import error_over_time, residual_autocorrelation
from pinav.figures.style import new_figure, title_panel
from pinav.report import Image, Paragraph, Section
from pinav.runs import RunFolder

PARTS = ("elapsed", "median", "high", "diverged")


def curve_of(arrays: dict[str, np.ndarray], key: str) -> ErrorCurve:
    """The curve that stands in arrays under this key."""
    return ErrorCurve(*(arrays[f"{key}/{part}"] for part in PARTS))


def evaluation_sections(folder: RunFolder) -> list[Section]:
    """Tables and figures of `pinav evaluate`, where it was run."""
    if not (folder.has("evaluation.json") and folder.has("evaluation.npz")):
        return []
    metrics = folder.read_json("evaluation.json")
    arrays = folder.read_arrays("evaluation.npz")
    intro = Paragraph(
        "Where the fit can be trusted: scores on trajectories that it was not fitted "
        f"to. {metrics['regions'].capitalize()}."
    )
    blocks = [intro, *tables(metrics), _over_time(folder, metrics, arrays)]
    if "autocorrelation" in arrays:
        blocks.append(_residuals(folder, arrays))
    return [Section("Evaluation", blocks)]


def _over_time(folder: RunFolder, metrics, arrays) -> Image:
    """One panel for each source of starts."""
    sources = list(next(iter(metrics["rollouts"].values())))
    figure = new_figure(7.5 if len(sources) > 1 else 4.4, 3.2)
    axes = np.atleast_1d(figure.subplots(1, len(sources)))
    for ax, source in zip(axes, sources, strict=True):
        curves = {
            model: curve_of(arrays, f"curve/{model}/{source}")
            for model in metrics["rollouts"]
        }
        error_over_time(curves, horizon=metrics["horizon"], ax=ax)
        title_panel(ax, f"rollouts from {source}")
    files = save_figure(figure, folder.path / "figures", "evaluation-errors")
    return Image(
        files.svg,
        "Position error of rollouts over time",
        "Position error over time since the start: median (line) and 90th percentile "
        "(dotted) over trajectories; a line ends where that share has diverged. "
        "Dashed: the training horizon.",
    )


def _residuals(folder: RunFolder, arrays) -> Image:
    ax = residual_autocorrelation(
        arrays["autocorrelation"],
        [int(count) for count in arrays["counts"]],
        [str(name) for name in arrays["channels"]],
    )
    figure = ax.get_figure(root=True)
    assert figure is not None
    files = save_figure(figure, folder.path / "figures", "evaluation-residuals")
    return Image(
        files.svg,
        "Autocorrelation of the residuals of the fit",
        "Autocorrelation of the residuals on the training data; grey: what 95 % of "
        "white residuals would show.",
        width=0.6,
    )
