"""The section of a report on the law behind a learned force."""

from collections.abc import Callable

from pinav.commands.discover.job import LAWS_FILE, SAMPLE_FILE, ranking
from pinav.commands.discover.metrics import ConstantRow, DiscoveryMetrics, LawRow
from pinav.commands.force_units import units_of
from pinav.commands.system_choice import read_system_of
from pinav.figures import formula_figure, law_figure
from pinav.figures.style import force_unit
from pinav.report import Cell, Code, Image, Paragraph, Section, Table, capitalise
from pinav.report.images import Figures
from pinav.runs import RunFolder
from pinav.trajectories import load


def law_sections(folder: RunFolder) -> list[Section]:
    """The findings of `pinav discover`, or nothing where it did not run."""
    if not folder.has(LAWS_FILE):
        return []
    metrics = folder.read_metrics(LAWS_FILE, DiscoveryMetrics)
    arrays, figures = folder.read_arrays(SAMPLE_FILE), Figures(folder.path)
    units = units_of(load(folder.path / "data.npz"), read_system_of(folder))
    figure = law_figure(
        [law.name for law in metrics.laws],
        [law.difference for law in metrics.laws],
        [law in metrics.close_laws for law in metrics.laws],
        arrays["learned"],
        arrays["sd"],
        arrays["law"],
        unit=force_unit(units),
    )
    image = figures.image(
        "laws",
        figure,
        "(a) Difference in BIC of laws refitted to the trajectories; laws in blue are "
        "not told apart, those in grey are, or extend the best one. (b) The best law "
        "and the learned force at points in visited regions, bars 95 %.",
        alt="Ranking of candidate laws, and the best one against the learned force",
    )
    sentences = [Paragraph(f"{capitalise(line)}.") for line in metrics.sentences()]
    details = [
        block
        for index, law in enumerate(metrics.close_laws)
        for block in _law(figures, index, law)
    ]
    content = [*sentences, image, ranking(metrics), *details]
    return [Section("The law behind the force", content)]


def _law(figures: Figures, index: int, law: LawRow) -> list[Table | Code | Image]:
    columns: dict[str, Callable[[ConstantRow], Cell]] = {
        "constant": lambda one: one.name,
        "value": lambda one: one.value,
        "sd": lambda one: one.sd,
        "2.5 %": lambda one: one.low,
        "97.5 %": lambda one: one.high,
        "identifiable": lambda one: "yes" if one.identifiable else "not identifiable",
    }
    caption = f"{law.name}: constants and 95 % intervals."
    blocks: list[Table | Code | Image] = []
    if (figure := formula_figure(law.latex)) is not None:
        words = f"Formula of the law: {law.name}."
        blocks.append(figures.image(f"law-{index}", figure, words, width=0.8))
    return [*blocks, Table.of(law.constants, columns, caption), Code(law.sympy)]
