"""`pinav fit`: one model of the unknown, fitted to given data."""

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from pinav.commands import FIT
from pinav.commands.command import CommandResult
from pinav.commands.data_file import read_data
from pinav.commands.fit import FitOptions
from pinav.commands.progress import Reporter
from pinav.commands.results import fingerprint, keep, start_run
from pinav.commands.sweep import run_files
from pinav.figures.fits import (
    fit_figure,
    force_line_figures,
    learned_force_figure,
    profile_figure,
    thermal_figures,
)
from pinav.fitting import Estimate
from pinav.fitting.checks.departures import Contradiction
from pinav.fitting.evidence.model_evidence import DECISIVE
from pinav.fitting.policy import POLICY
from pinav.fitting.structure.trace import Hypothesis
from pinav.forces import HillsTerm
from pinav.learning.account import account
from pinav.learning.findings import Findings, FoundStructure, FoundTerm
from pinav.learning.learn import infer
from pinav.learning.learned import Learned, is_written
from pinav.learning.plan import FitPlan, choose_system, plan_fit
from pinav.learning.thermal import ThermalFindings
from pinav.learning.verdict import CREDIBLE
from pinav.report import (
    NO_UNIT,
    AbstractBlock,
    Cell,
    Paragraph,
    Section,
    Table,
    heading,
    number,
    quantity,
)
from pinav.runs import RunFolder


def run(options: FitOptions) -> CommandResult:
    """Fit as the command line does."""
    file = options.file
    if file is None:
        return run_files(FIT, options)
    settings = options.settings
    data = read_data(file, options.reading)
    plan = plan_fit(
        choose_system(settings.system, data),
        data,
        model=settings.model,
        recipe=options.recipe,
        train=settings.train,
        seed=settings.seed,
        width=settings.width,
        depth=settings.depth,
    )
    identity = {"data": fingerprint(plan.data), "system": plan.system.name}
    settings_of_run = (settings, options.recipe, options.reading)
    folder = start_run(FIT, options, *settings_of_run, **identity)
    return keep(FIT, folder, fit(plan, folder).findings)


def fit(plan: FitPlan, folder: RunFolder) -> Learned:
    """Fit and write the result; what the folder holds is not done again."""
    if is_written(folder):
        learned = Learned.open(folder.path)
    else:
        name = plan.choice.name
        with Reporter(folder, name) as report:
            checkpoint = folder.checkpoint(name)
            learned = infer(plan, checkpoint=checkpoint, on_progress=report)
        learned = learned.write(folder)
    return dataclasses.replace(learned, found=account(plan, learned))


def sections(fit: Findings) -> list[Section]:
    """The errors and constants of a fit, its structure, thermal motion, the force."""
    first: list[AbstractBlock] = [Paragraph(fit.verdict.says)]
    if fit.support is not None:
        first.append(Paragraph(support_sentence(fit.support)))
    first += [*map(Paragraph, fit.remarks), *_tables(fit), fit_figure(fit)]
    shown = [Section(f"The fit: {fit.model}, {fit.recipe}", first)]
    if fit.structure is not None:
        shown.append(Section("The structure of the force", _structure(fit)))
    if fit.thermal is not None:
        blocks = [*_thermal(fit.thermal), *thermal_figures(fit)]
        shown.append(Section("The thermal motion", blocks))
    if force := _force(fit):
        shown.append(Section("The learned force", force))
    if fit.contradictions:
        shown.append(Section("Checks of the fit", [_contradictions(fit)]))
    return shown


def _tables(fit: Findings) -> list[Table]:
    """Errors, choices of the evidence, loss and constants, as far as there are any."""
    tables = [_errors(fit)]
    if fit.hyperparameters is not None:
        name, unit = "noise of a position", fit.units.get("x", "")
        if fit.recipe == "langevin":
            name, time = "thermal noise, √(2D)", fit.units.get("t", "")
            unit = unit if {unit, time} & set(NO_UNIT) else f"{unit}/√{time}"
        chosen = {
            heading(name, unit): fit.hyperparameters.noise,
            "log evidence": fit.hyperparameters.log_evidence,
            "iterations": fit.iterations,
            "outcome": fit.outcome,
        }
        tables.append(_one_row(chosen, "What the evidence chose."))
    if fit.losses is not None:
        start, end = fit.losses.values[0][0], fit.losses.values[0][-1]
        loss = {"start": float(start), "end": float(end), "outcome": fit.outcome}
        tables.append(_one_row(loss, "Training loss."))
    if fit.constants:
        tables.append(constants_table(fit.constants))
    return tables


def constants_table(constants: Mapping[str, Estimate]) -> Table:
    """Learned constants with units and 95 % intervals."""
    columns: dict[str, Callable[[tuple[str, Estimate]], Cell]] = {
        "constant": lambda one: one[0],
        "unit": lambda one: one[1].unit,
        "value": lambda one: number(one[1].value, 6),
        "standard deviation": lambda one: one[1].sd,
        "2.5 %": lambda one: number(one[1].low, 6),
        "97.5 %": lambda one: number(one[1].high, 6),
    }
    return Table.of(list(constants.items()), columns, "Constants learned.")


def _errors(fit: Findings) -> Table:
    """Errors by the length of rollouts for a recording, else those of whole ones."""
    length, time = (fit.units.get(name, "1") for name in ("x", "t"))
    restarts = fit.restarts
    if restarts is None:
        units = {"position": length, **fit.units}
        rmse = {heading(n, units.get(n, "1")): error for n, error in fit.rmse.items()}
        return _one_row(rmse, "Root-mean-square errors of rollouts.")
    pairs = zip(restarts.lengths, restarts.errors, strict=True)
    errors = {
        heading(f"after {quantity(float(after), time)}", length): float(error)
        for after, error in pairs
    }
    return _one_row(
        errors,
        f"Median end-point error of {restarts.rollouts} rollouts from observed "
        "positions, by their length. A rollout of the whole film adds up all that "
        "wanders; its error is in metrics.json.",
    )


def support_sentence(gain: float) -> str:
    """Evidence for a field beside the commands, with the remedy."""
    nats = f"{number(abs(gain), 3)} nats"
    if gain > DECISIVE:
        return f"field of position: supported, by {nats} over the known physics alone"
    lead = (
        "against it"
        if gain < -DECISIVE
        else f"which is not decisive (below {DECISIVE:g})"
    )
    sign = "+" if gain > 0 else "−"
    return (
        "field of position: not supported: its log evidence over the known physics "
        f"alone is {sign}{nats}, {lead}. Do not steer by it: use "
        "the system without a field, which pinav fit --model physics-only gives"
    )


def _structure(fit: Findings) -> list[AbstractBlock]:
    """Result of the search, and each profile with its band."""
    assert fit.structure is not None
    terms = enumerate(fit.structure.terms)
    figures = filter(None, (profile_figure(index, term, fit) for index, term in terms))
    blocks: list[AbstractBlock] = [*map(Paragraph, structure_sentences(fit.structure))]
    if fit.structure.tried:
        blocks.append(_hypotheses(fit.structure.tried))
    return [*blocks, *figures]


def _contradictions(fit: Findings) -> Table:
    """Table of departures from what the system states."""
    columns: dict[str, Callable[[Contradiction], Cell]] = {
        "departure": lambda one: one.name,
        "gain (nats)": lambda one: f"{one.gain:.1f}",
        "it would be": lambda one: one.clause,
    }
    return Table.of(
        fit.contradictions,
        columns,
        "Departures from what the system states: the gain of log evidence over it, "
        "beside kernels that are as free as those of the fit; one above "
        f"{CREDIBLE:g} nats counts.",
    )


def _hypotheses(tried: Sequence[Hypothesis]) -> Table:
    """Table of the hypotheses of a search, and how each of them ended."""
    columns: dict[str, Callable[[Hypothesis], Cell]] = {
        "terms": lambda one: " + ".join(one.kinds) or "free kernels",
        "log evidence (nats)": lambda one: number(one.log_evidence, 6),
        "residuals (noise = 1)": lambda one: number(one.misfit, 4),
        "after (s)": lambda one: number(one.seconds, 3),
        "ended": lambda one: one.ended,
    }
    return Table.of(
        tried,
        columns,
        "Hypotheses that the search weighed, in their order. Log evidences of terms "
        "that were polished belong to linearised data; those of fits to the data.",
    )


def structure_sentences(structure: FoundStructure) -> list[str]:
    """One sentence on the structure, and one on the rotation where it was weighed."""
    whose = "the network's teacher: " if structure.of_teacher else ""
    lines = [_structure_sentence(structure)]
    if structure.rotation is not None:
        nats = f"{number(structure.rotation, 3)} nats"
        lines.append(
            "force: a gradient and a rotational part (kernel-mixture), which the "
            f"log evidence prefers to a potential alone by {nats}"
            if structure.turns
            else "force: a potential (kernel-potential); the log evidence of a "
            f"rotational part beside it differs by {nats}"
        )
    return [f"{whose}{line}" for line in lines]


def _structure_sentence(structure: FoundStructure) -> str:
    gain = structure.gain
    nats = "" if gain is None else f"{number(gain, 3)} nats"
    if structure.terms:
        names = ", and ".join(map(term_words, structure.terms))
        if gain is None:
            return f"structure: {names}; a fit of free kernels alone diverges"
        if gain > DECISIVE:
            return f"structure: {names}; {nats} over free kernels"
        return (
            f"structure: {names}; it is simpler than free kernels, which the log "
            f"evidence cannot tell from it ({nats} over them)"
        )
    if not structure.sought:
        tracks, numbers = POLICY.least_data
        return (
            "structure: free kernels; none was sought, which takes "
            f"{tracks} trajectories and {numbers} numbers"
        )
    if gain is None:
        return "structure: free kernels; no structure tried explains the data"
    return (
        "structure: free kernels; the log evidence of the best structure tried "
        f"differs by {nats}"
    )


def term_words(term: FoundTerm) -> str:
    """A term in words and numbers."""
    place, law = _place(term), term.law
    if law is None:
        return place
    constants = [
        f"{name} {number(one.value, 4)} ± {quantity(one.sd, one.unit, 2)}"
        for name, one in law.constants.items()
    ]
    return f"{place} (potential: {law.name} of {', '.join(constants)})"


def _place(term: FoundTerm) -> str:
    if not term.geometry:
        return term.name
    if term.name in ("wall", "shear layer"):
        (angle,) = term.geometry
        degrees = number(float(np.degrees(angle.value) % 360), 5)
        spread = number(float(np.degrees(angle.sd)), 2)
        return f"{term.name} with its normal at {degrees} ± {spread} degrees"
    if term.name == HillsTerm.kinds[0]:
        count = HillsTerm.count(len(term.geometry))
        places = _points(term.geometry[: 2 * count], 2)
        return f"{count} {term.name} at {places}"
    word = "about" if term.name.startswith("central") else "with"
    groups = itertools.groupby(term.geometry, lambda one: one.unit)
    numbers = (_points(list(group)) for _, group in groups)
    return f"{term.name} {word} {', '.join(numbers)}"


def _points(numbers: Sequence[Estimate], dim: int | None = None) -> str:
    """Numbers of one unit, in brackets or as points, with the largest deviation."""
    values = np.reshape([one.value for one in numbers], (-1, dim or len(numbers)))
    points = (", ".join(number(float(one), 4) for one in row) for row in values)
    spread = quantity(max(one.sd for one in numbers), numbers[0].unit, 2)
    return f"{', '.join(f'({point})' for point in points)} ± {spread}"


def _thermal(thermal: ThermalFindings) -> list[AbstractBlock]:
    """Whether the fit explains the increments, and what the observation does."""
    checks = thermal.checks
    lags = range(1, 1 + len(checks.correlations))
    ratios: list[tuple[str, Estimate]] = [
        (f"{name} along {', '.join(one.channels)}", value)
        for one in thermal.observed
        for name, value in (
            ("diffusion, mean over the data,", one.diffusion),
            ("exposure as a share of the interval,", one.exposure),
            ("error of a position, in steps by diffusion,", one.error),
        )
        if value is not None
    ]
    ratios += [
        (
            f"diffusion of every {one.every} samples over that of all, along "
            f"{', '.join(thermal.named(one.axes))}",
            one.ratio,
        )
        for one in checks.thinned
    ]
    correlations = zip(thermal.channels, checks.correlations.T, strict=True)
    return [
        *map(Paragraph, thermal_sentences(thermal)),
        Table(
            ("channel", *(f"{lag} apart" for lag in lags)),
            [(name, *map(float, values)) for name, values in correlations],
            "Correlations of innovations so many samples apart; those of independent "
            f"ones lie within {checks.band:.3f} (two standard deviations).",
        ),
        Table(
            ("quantity", "value", "standard deviation"),
            [(name, one.value, one.sd) for name, one in ratios],
            "Diffusion, blur and error of the positions, and the diffusion of thinned "
            "data.",
        ),
    ]


def thermal_sentences(thermal: ThermalFindings) -> list[str]:
    """Whether the increments are explained, where diffusion varies, what drifts."""
    lines = [thermal.statement]
    for one in thermal.observed:
        along = f" along {', '.join(one.channels)}" if len(thermal.observed) > 1 else ""
        mean = f"{number(one.diffusion.value, 3)} ± {number(one.diffusion.sd, 2)} (sd)"
        if one.high > one.low:
            lines.append(
                f"diffusion{along}: {number(one.low, 3)} to {number(one.high, 3)} for "
                f"nine tenths of the data, mean {mean}"
            )
    path = thermal.reference
    if path is not None:
        lines.append(
            f"the zero of {thermal.channels[path.axis]} drifts by "
            f"{number(float(path.values.std()), 3)} (sd over {len(path.values)} knots, "
            f"each known to {number(float(path.sd.mean()), 2)})"
        )
    return lines


def _force(fit: Findings) -> list[AbstractBlock]:
    """Maps or lines of the force, and its errors where the truth is known."""
    maps = learned_force_figure(fit)
    blocks: list[AbstractBlock] = [] if maps is None else [maps]
    blocks += force_line_figures(fit)
    if fit.force_error is not None:
        errors = {f"{region} (%)": 100 * one for region, one in fit.force_error.items()}
        caption = "Relative L2 error of the force against the system's truth"
        if maps is not None:
            caption += ", on visited and near grid points, and on the whole grid"
        blocks.append(_one_row(errors, f"{caption}."))
    return blocks


def _one_row(values: Mapping[str, Cell], caption: str) -> Table:
    return Table(tuple(values), [tuple(values.values())], caption)
