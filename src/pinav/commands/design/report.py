"""The sections of a report on a design of experiments."""

from collections.abc import Mapping

import numpy as np

from pinav.commands.design.metrics import DesignMetrics
from pinav.figures.design import bounds_figure, recordings_figure
from pinav.figures.images import Figures
from pinav.report import Image, Paragraph, Section, Table
from pinav.runs import RunFolder


def design_sections(folder: RunFolder) -> list[Section]:
    """The sections of a finished run."""
    metrics = folder.read_metrics("metrics.json", DesignMetrics)
    arrays, figures = folder.read_arrays("results.npz"), Figures(folder.path)
    content: list[Paragraph | Table | Image] = [
        Paragraph(line) for line in metrics.sentences()
    ]
    if metrics.designs:
        content += [metrics.table(), _bounds(figures, arrays, metrics)]
    return [Section("Outcome", content), Section("Recordings", [_map(figures, arrays)])]


def _bounds(
    figures: Figures, arrays: Mapping[str, np.ndarray], metrics: DesignMetrics
) -> Image:
    curves = {
        name: [arrays[f"bound/{name}/{k}"] for k in range(row.campaigns)]
        for name, row in metrics.designs.items()
    }
    return figures.image(
        "design-bounds",
        bounds_figure(curves, metrics.accuracy),
        "Bound of the relative error of the force along the planned way (95 %), after "
        "each trajectory of each campaign.",
        width=0.8,
    )


def _map(figures: Figures, arrays: Mapping[str, np.ndarray]) -> Image:
    names = [name for name in arrays if name.startswith("path/")]
    design = names[0].split("/")[1] if names else ""
    paths = [arrays[name] for name in names if name.split("/")[1] == design]
    what = {"recorded": "the recordings", "": "no trajectory"}.get(
        design, f"the first campaign of the {design} design"
    )
    return figures.image(
        "design-recordings",
        recordings_figure(arrays, paths),
        f"Standard deviation of the force after {what}, its trajectories, and the way "
        "that is planned then.",
        width=0.7,
    )
