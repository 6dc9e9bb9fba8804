"""`pinav discover`: the law behind the learned force of a run, in blocks."""

from collections.abc import Callable

from pinav.analysis import (
    Candidate,
    Centrality,
    CentralTest,
    Discovery,
    EstimatedConstant,
    Verdict,
    discover,
)
from pinav.commands import DISCOVER
from pinav.commands.command import CommandResult
from pinav.commands.discover import DiscoverOptions
from pinav.commands.results import keep, open_fit
from pinav.figures import formula_figure, law_figure
from pinav.report import AbstractBlock, Cell, Code, Paragraph, Section, Table, number

DIGITS = 6
"""Significant digits of a constant: intervals of precise data differ in the third."""


def run(options: DiscoverOptions) -> CommandResult:
    """Find laws as the command line does."""
    fit = open_fit(options.run)
    return keep(DISCOVER, fit.folder, discover(fit, refits=options.refits))


def sections(found: Discovery) -> list[Section]:
    """The law, its rivals, and whether the force is central at all."""
    blocks: list[AbstractBlock] = [*map(Paragraph, sentences(found))]
    blocks += [law_figure(found), ranking(found)]
    for index, law in enumerate(found.close):
        blocks += _law(index, law)
    return [Section("The law behind the force", blocks)]


def sentences(found: Discovery) -> list[str]:
    """The finding on the law, its candidates, and whether the force is central."""
    names = ", ".join(law.name for law in found.close)
    law = {
        Verdict.IDENTIFIED: f"Law: {names}.",
        Verdict.NOT_IDENTIFIABLE: f"Law: not identifiable from these data ({names}).",
        Verdict.NO_LAW_FITS: "Law: none; no candidate explains the data as well as the "
        f"learned force, and the nearest is {found.best.name}.",
    }
    terms = " + ".join(found.structure)
    candidates = (
        f"Candidates: the laws that have the structure of the fit ({terms})."
        if terms
        else "Candidates: laws of the whole force, and sums of up to three; the fit "
        "has no structure that laws could follow."
    )
    return [law[found.verdict], candidates, central_sentence(found.central)]


def central_sentence(test: CentralTest) -> str:
    """The test for a central force in words, with the centre where there is one."""
    line = (
        f"Central force: {test.verdict.value}; tangential over radial "
        f"{test.ratio:.3g}, {test.noise_ratio:.3g} expected of a central one, "
        f"p = {test.p_value:.3g}"
    )
    if test.verdict is Centrality.NOT_CENTRAL:
        return f"{line}."
    if test.verdict is Centrality.UNDECIDED:
        return f"{line}; the data do not determine a centre."
    (x, y), (sd_x, sd_y) = test.center, test.center_sd
    return f"{line}; centre ({x:.5g} ± {sd_x:.2g}, {y:.5g} ± {sd_y:.2g})."


def ranking(found: Discovery) -> Table:
    """The refitted laws, the best one first."""
    columns: dict[str, Callable[[Candidate], Cell]] = {
        "law": lambda law: law.name,
        "constants": lambda law: len(law.constants),
        "ΔBIC": lambda law: law.delta_bic,
        "noise": lambda law: law.noise,
        "refit": lambda law: str(law.outcome),
        "explains the data": lambda law: "yes" if law.fits else "no",
        "extends the best": lambda law: "yes" if law.extends_best else "no",
    }
    caption = (
        "Candidate laws refitted to the trajectories. A law that extends the best one "
        "has it as a special case, and is no rival of it."
    )
    return Table.of(found.candidates, columns, caption)


def _law(index: int, law: Candidate) -> list[AbstractBlock]:
    columns: dict[str, Callable[[EstimatedConstant], Cell]] = {
        "constant": lambda one: one.name,
        "unit": lambda one: one.unit,
        "value": lambda one: number(one.value, DIGITS),
        "sd": lambda one: one.sd,
        "2.5 %": lambda one: number(one.low, DIGITS),
        "97.5 %": lambda one: number(one.high, DIGITS),
        "identifiable": lambda one: "yes" if one.identifiable else "not identifiable",
    }
    caption = f"{law.name}: constants and 95 % intervals."
    drawn = formula_figure(law.latex, f"law-{index}", law.name)
    formula = [] if drawn is None else [drawn]
    return [*formula, Table.of(law.constants, columns, caption), Code(law.sympy)]
