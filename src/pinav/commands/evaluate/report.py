"""The section of a report that an evaluation fills."""

from collections.abc import Mapping

import numpy as np

from pinav.commands.evaluate.job import ARRAYS_FILE, EVALUATION_FILE
from pinav.commands.evaluate.metrics import EvaluationMetrics
from pinav.commands.evaluate.tables import tables
from pinav.evaluation import ErrorCurve
from pinav.figures.errors import error_over_time, residual_autocorrelation
from pinav.figures.images import Figures
from pinav.figures.style import new_figure, title_panel
from pinav.report import Image, Paragraph, Section, capitalise
from pinav.runs import RunFolder


def evaluation_sections(folder: RunFolder) -> list[Section]:
    """Tables and figures of `pinav evaluate`, where it was run."""
    if not (folder.has(EVALUATION_FILE) and folder.has(ARRAYS_FILE)):
        return []
    metrics = folder.read_metrics(EVALUATION_FILE, EvaluationMetrics)
    arrays = folder.read_arrays(ARRAYS_FILE)
    figures = Figures(folder.path)
    words = (metrics.purpose, f"{capitalise(metrics.regions)}.", *metrics.notes)
    blocks = [
        *map(Paragraph, words),
        *tables(metrics),
        _over_time(figures, metrics, arrays),
    ]
    if "autocorrelation" in arrays:
        blocks.append(_residuals(figures, arrays))
    return [Section("Evaluation", blocks)]


def _over_time(
    figures: Figures, metrics: EvaluationMetrics, arrays: Mapping[str, np.ndarray]
) -> Image:
    """One panel for each source of starts."""
    sources = list(next(iter(metrics.rollouts.values())))
    figure = new_figure(7.5 if len(sources) > 1 else 4.4, 3.2)
    axes = np.atleast_1d(figure.subplots(1, len(sources)))
    for ax, source in zip(axes, sources, strict=True):
        curves = {
            model: ErrorCurve.from_arrays(arrays, f"curve/{model}/{source}")
            for model in metrics.rollouts
        }
        error_over_time(curves, horizon=metrics.horizon, unit=metrics.unit, ax=ax)
        words = f"the data ({metrics.error_name})" if source == "data" else source
        title_panel(ax, f"rollouts from {words}")
    return figures.image(
        "evaluation-errors",
        figure,
        "Position error over time since the start: median (line) and 90th percentile "
        "(dotted) over trajectories; a line ends where that fraction has diverged. "
        "Dashed: the training horizon.",
    )


def _residuals(figures: Figures, arrays: Mapping[str, np.ndarray]) -> Image:
    axes = residual_autocorrelation(
        arrays["autocorrelation"],
        [int(count) for count in arrays["counts"]],
        [str(name) for name in arrays["channels"]],
    )
    return figures.image(
        "evaluation-residuals",
        axes,
        "Autocorrelation of the residuals on the training data; grey: what 95 % of "
        "white residuals would show.",
        width=0.6,
    )
