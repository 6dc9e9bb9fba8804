"""Figures and sections of the studies."""

from collections import defaultdict
from typing import Any

from pinav.commands.study.job import HEADER
from pinav.commands.study.paper_weakness import weakness_sections, weakness_table
from pinav.figures import save_figure
from pinav.figures.errors import scaling_figure
from pinav.report import Image, Paragraph, Section, Table
from pinav.report.text import as_text
from pinav.runs import RunFolder

AXES = {
    "data-efficiency": ("trajectories", "number of trajectories"),
    "noise": ("sigma", "noise of the observations"),
}
"""Column and label of the x axis of each study."""


def study_sections(folder: RunFolder) -> list[Section]:
    """The sections of a study's report."""
    metrics = folder.read_json("metrics.json")
    if metrics["study"] == "paper-weakness":
        return weakness_sections(folder, metrics)
    column, label = AXES[metrics["study"]]
    rows = metrics["rows"]
    figure = scaling_figure(
        _series(rows, column, "force visited"),
        _series(rows, column, "rollouts median"),
        quantity=label,
    )
    files = save_figure(figure, folder.path / "figures", metrics["study"])
    return [
        Section(
            f"{metrics['study'].capitalize()} on {metrics['scenario']}",
            [
                Image(
                    files.svg,
                    f"Force and rollout error over the {label}",
                    "Synthetic data, dimensionless. Lines: median over seeds. A model "
                    "without points failed, diverged or has no force; the table says "
                    "which.",
                ),
                Paragraph(
                    "Force: relative L2 error on ground within 0.35 of the training "
                    "data. Rollouts: median over held-out clean starts of the "
                    "root-mean-square position error."
                ),
                table(rows),
            ],
        )
    ]


def _series(rows: list[dict[str, Any]], x: str, y: str) -> dict[str, list]:
    found: dict[str, list] = defaultdict(list)
    for row in rows:
        points = found[row["model"]]
        if isinstance(row[y], float):
            points.append((row[x], row[y]))
    return found


def table(rows: list[dict[str, Any]]) -> Table:
    """All cells of a study, errors of the force in percent."""
    percent = [name for name in HEADER if name.startswith("force")]
    header = tuple(f"{name} (%)" if name in percent else name for name in HEADER)
    cells = [
        tuple(
            100 * row[name]
            if name in percent and isinstance(row[name], float)
            else row[name]
            for name in HEADER
        )
        for row in rows
    ]
    return Table(
        header,
        cells,
        "Relative L2 error of the force by ground, and position errors of rollouts: "
        "median and 90th percentile over held-out starts, share diverged.",
    )


def text(metrics: dict[str, Any]) -> str:
    """The table of a study for a terminal."""
    if metrics["study"] == "paper-weakness":
        return as_text(weakness_table(metrics))
    return as_text(table(metrics["rows"]))
