"""What a study has to say: its figure and its table."""

import math
from collections import defaultdict
from collections.abc import Callable

from pinav.commands.study.result import VISITED, Study, StudyFit
from pinav.figures import Picture
from pinav.figures.errors import scaling_figure
from pinav.report import Cell, Paragraph, Section, Table

COLUMNS: dict[str, Callable[[StudyFit], Cell]] = {
    "model": lambda fit: fit.model,
    "seed": lambda fit: fit.seed,
    "trajectories": lambda fit: fit.trajectories,
    "sigma": lambda fit: fit.sigma,
    "outcome": lambda fit: fit.outcome,
    "force visited": lambda fit: fit.force_error(VISITED),
    "force near": lambda fit: fit.force_error("near"),
    "force unvisited": lambda fit: fit.force_error("unvisited"),
    "cosine visited": lambda fit: fit.cosine(VISITED),
    "rollouts median": lambda fit: fit.rollout("median"),
    "rollouts 90 %": lambda fit: fit.rollout("high"),
    "rollouts diverged": lambda fit: fit.rollout("diverged"),
}
"""Columns of `study.csv`, a published format: errors of the force are fractions."""

QUANTITIES = {
    "data-efficiency": "number of trajectories",
    "noise": "noise of the observations",
}
"""What each study varies."""


def sections(study: Study) -> list[Section]:
    """The figure of a study, and a row for each fit."""
    quantity = QUANTITIES[study.name]
    picture = Picture(
        study.name,
        lambda: scaling_figure(
            _series(study, lambda fit: fit.force_error(VISITED)),
            _series(study, lambda fit: fit.rollout("median")),
            quantity=quantity,
        ),
        "Synthetic data, dimensionless. Lines: median over seeds. A model without "
        "points failed, diverged or has no force; the table says which.",
        alt=f"Force and rollout error over the {quantity}",
    )
    note = Paragraph(
        "Force: relative L2 error on ground within 0.35 of the training data. "
        "Rollouts: median over held-out clean starts of the root-mean-square position "
        "error."
    )
    heading = f"{study.name.capitalize()} on {study.scenario}"
    return [Section(heading, [picture, note, table(study)])]


def _series(
    study: Study, error: Callable[[StudyFit], float]
) -> dict[str, list[tuple[float, float]]]:
    """The points of each model that are numbers."""
    series: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for fit in study.fits:
        place = fit.sigma if study.name == "noise" else float(fit.trajectories)
        points = series[fit.model]
        if math.isfinite(error(fit)):
            points.append((place, error(fit)))
    return series


def table(study: Study) -> Table:
    """All fits of a study, errors of the force in percent."""
    columns: dict[str, Callable[[StudyFit], Cell]] = {}
    for name, cell in COLUMNS.items():
        if name.startswith("force"):
            region = name.removeprefix("force ")
            columns[f"{name} (%)"] = lambda fit, at=region: 100 * fit.force_error(at)
        else:
            columns[name] = cell
    caption = (
        "Relative L2 error of the force by ground, and position errors of rollouts: "
        "median and 90th percentile over held-out starts, share diverged."
    )
    return Table.of(study.fits, columns, caption)


def csv_rows(study: Study) -> list[list[Cell]]:
    """The rows of `study.csv`, empty where a number is not defined."""
    rows = [[cell(fit) for cell in COLUMNS.values()] for fit in study.fits]
    return [
        ["" if c != c else "diverged" if c == math.inf else c for c in row]
        for row in rows
    ]
