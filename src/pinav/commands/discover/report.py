"""The section of a report on the law behind a learned force."""

from typing import Any

import numpy as np

from pinav.commands.discover.job import (
    LAWS_FILE,
    SAMPLE_FILE,
    close_laws,
    verdict_lines,
)
from pinav.figures import law_figure, save_figure
from pinav.figures.style import force_unit
from pinav.report import Code, Image, Paragraph, Section, Table
from pinav.runs import RunFolder
from pinav.trajectories import load


def law_sections(folder: RunFolder) -> list[Section]:
    """The results of `pinav discover`, or nothing where it did not run."""
    if not folder.has(LAWS_FILE):
        return []
    units = load(folder.path / "data.npz").units
    metrics = folder.read_json(LAWS_FILE)
    laws, arrays = metrics["laws"], folder.read_arrays(SAMPLE_FILE)
    deltas = [np.inf if law["delta_bic"] is None else law["delta_bic"] for law in laws]
    figure = law_figure(
        [law["name"] for law in laws],
        deltas,
        arrays["learned"],
        arrays["sd"],
        arrays["law"],
        formula=laws[0]["latex"],
        unit=force_unit(units),
    )
    files = save_figure(figure, folder.path / "figures", "laws")
    image = Image(
        files.svg,
        "Ranking of candidate laws, and the best one against the learned force",
        "(a) Difference in BIC of laws refitted to the trajectories. (b) The best law "
        "and the learned force at points on visited ground, bars 95 %.",
    )
    sentences = [Paragraph(line) for line in verdict_lines(metrics)]
    details = [block for law in close_laws(metrics) for block in _law(law)]
    content = [*sentences, image, _ranking(laws), *details]
    return [Section("The law behind the force", content)]


def _ranking(laws: list[dict[str, Any]]) -> Table:
    rows = [
        (
            law["name"],
            law["num_constants"],
            law["delta_bic"],
            law["noise"],
            law["outcome"],
            "yes" if law["fits"] else "no",
        )
        for law in laws
    ]
    header = ("law", "constants", "ΔBIC", "noise", "refit", "explains the data")
    return Table(header, rows, "Candidate laws refitted to the trajectories.")


def _law(law: dict[str, Any]) -> list[Table | Code]:
    rows = [
        (
            own["name"],
            own["value"],
            own["sd"],
            own["low"],
            own["high"],
            "yes" if own["identifiable"] else "not identifiable",
        )
        for own in law["constants"]
    ]
    header = ("constant", "value", "sd", "2.5 %", "97.5 %", "identifiable")
    caption = f"{law['name']}: constants and 95 % intervals."
    return [Table(header, rows, caption), Code(f"{law['latex']}\n\n{law['sympy']}")]
