"""Figures and sections of the studies."""

from collections import defaultdict
from collections.abc import Iterable

import msgspec

from pinav.commands.cells import Cell, percent
from pinav.commands.study.metrics import (
    HEADER,
    NoiseMetrics,
    ScalingMetrics,
    StudyMetrics,
    StudyRow,
)
from pinav.figures.errors import scaling_figure
from pinav.figures.images import Figures
from pinav.report import Paragraph, Section, Table
from pinav.report.text import as_text
from pinav.runs import RunFolder


def study_sections(folder: RunFolder) -> list[Section]:
    """The sections of a study's report."""
    metrics = msgspec.convert(folder.read_json("metrics.json"), StudyMetrics)
    noise = isinstance(metrics, NoiseMetrics)
    places = [row.sigma if noise else float(row.trajectories) for row in metrics.rows]
    figure = scaling_figure(
        _series(metrics, places, [row.force_visited for row in metrics.rows]),
        _series(metrics, places, [row.rollouts_median for row in metrics.rows]),
        quantity=metrics.quantity,
    )
    return [
        Section(
            f"{metrics.name.capitalize()} on {metrics.scenario}",
            [
                Figures(folder.path).image(
                    metrics.name,
                    figure,
                    "Synthetic data, dimensionless. Lines: median over seeds. A model "
                    "without points failed, diverged or has no force; the table says "
                    "which.",
                    alt=f"Force and rollout error over the {metrics.quantity}",
                ),
                Paragraph(
                    "Force: relative L2 error on ground within 0.35 of the training "
                    "data. Rollouts: median over held-out clean starts of the "
                    "root-mean-square position error."
                ),
                table(metrics.rows),
            ],
        )
    ]


def _series(
    metrics: ScalingMetrics, places: Iterable[float], errors: Iterable[Cell]
) -> dict[str, list[tuple[float, float]]]:
    """The points of each model that are numbers."""
    series: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for row, place, error in zip(metrics.rows, places, errors, strict=True):
        points = series[row.model]
        if isinstance(error, float):
            points.append((place, error))
    return series


def table(rows: Iterable[StudyRow]) -> Table:
    """All cells of a study, errors of the force in percent."""
    scales = [name.startswith("force") for name in HEADER]
    header = [
        f"{name} (%)" if scaled else name
        for name, scaled in zip(HEADER, scales, strict=True)
    ]
    cells = [
        [
            percent(value) if scaled else value
            for value, scaled in zip(msgspec.structs.astuple(row), scales, strict=True)
        ]
        for row in rows
    ]
    return Table(
        header,
        cells,
        "Relative L2 error of the force by ground, and position errors of rollouts: "
        "median and 90th percentile over held-out starts, share diverged.",
    )


def text(metrics: StudyMetrics) -> str:
    """The table of a study for a terminal."""
    return as_text(table(metrics.rows))
