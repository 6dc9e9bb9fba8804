"""`pinav analyse`: maps, parts and sensitivities of what a run has learned."""

from collections.abc import Callable

import msgspec
import numpy as np

from pinav.analysis import (
    Analysis,
    ConstantEffect,
    EntropyProduction,
    LyapunovMap,
    SobolIndices,
    TrajectoryEffect,
    analyse,
)
from pinav.commands import ANALYSE
from pinav.commands.analyse import AnalyseOptions
from pinav.commands.command import CommandResult
from pinav.commands.results import keep, open_fit
from pinav.figures import (
    constants_figure,
    helmholtz_figure,
    influence_figure,
    lyapunov_figure,
    potential_figure,
    sobol_figure,
)
from pinav.report import (
    AbstractBlock,
    Cell,
    Paragraph,
    Section,
    Table,
    heading,
    quantity,
)


def run(options: AnalyseOptions) -> CommandResult:
    """Analyse as the command line does."""
    settings = msgspec.structs.asdict(options)
    fit = open_fit(settings.pop("run"))
    del settings["json"]
    return keep(ANALYSE, fit.folder, analyse(fit, **settings))


Blocks = list[AbstractBlock]


def sections(analysis: Analysis) -> list[Section]:
    """Maps of what was learned, and what it depends on."""
    entropy = [] if analysis.entropy is None else [analysis.entropy]
    growth, units, index = analysis.lyapunov, analysis.units, analysis.reference
    ends = lyapunov_figure(
        growth, trajectory=index, path=analysis.paths[index], units=units
    )
    rollout = [Paragraph(growth_sentence(growth, units.get("t", ""))), ends]
    blocks_by_title = {
        "What was learned": _learned(analysis),
        "Out of equilibrium": [Paragraph(entropy_sentence(e)) for e in entropy],
        "What the field depends on": _influence(analysis) + _constants(analysis),
        "What a rollout depends on": rollout + _sobol(analysis),
        "Left out of the analysis": list(map(Paragraph, analysis.left_out)),
    }
    return [
        Section(title, blocks) for title, blocks in blocks_by_title.items() if blocks
    ]


def _learned(analysis: Analysis) -> Blocks:
    split, field, doubt = analysis.split, analysis.field, analysis.doubt
    sd = None if doubt is None else doubt.rotational
    shown = {"path": analysis.all_paths, "units": analysis.units}
    fractions = (
        split.rotational_fraction,
        split.least_fraction,
        split.greatest_fraction,
    )
    blocks: Blocks = [
        Paragraph(rotation_sentence(analysis)),
        helmholtz_figure(split, field, spread=sd, **shown),
        Table(
            ("part", "fraction (%)", "least (%)", "greatest (%)", "sd (%)"),
            [("rotational", *(100 * f for f in fractions), sd and 100 * sd)],
            "Least: harmonic fields all count as gradients, so that this is what no "
            "potential explains. Greatest: they all count as rotational. sd: over "
            "posterior samples.",
        ),
    ]
    if doubt is not None:
        parts = ", ".join(f"{k} {v:.0%}" for k, v in doubt.significant.items())
        words = f"Field above two standard deviations: {parts} of the region."
        blocks.append(Paragraph(words))
    origin = "learned" if analysis.is_potential_learned else "of the gradient part"
    known = None if doubt is None else doubt.sd
    drawn = potential_figure(
        analysis.potential, field, origin=origin, sd=known, **shown
    )
    return [*blocks, drawn]


def rotation_sentence(analysis: Analysis) -> str:
    """The rotational fraction in words, and what its bounds mean."""
    split, doubt = analysis.split, analysis.doubt
    reach = quantity(analysis.field.regions.near, analysis.units.get("x", ""))
    spread = "" if doubt is None else f" ± {doubt.rotational:.2%} (sd)"
    return (
        f"Rotational part: {split.rotational_fraction:.2%}{spread} of the square of "
        f"the learned field within {reach} of the data. Near the data alone some "
        "fields are gradient and rotational at once (harmonic fields): counted as "
        f"gradient they leave {split.least_fraction:.2%}, counted as rotational "
        f"{split.greatest_fraction:.2%}."
    )


def entropy_sentence(entropy: EntropyProduction) -> str:
    """The rate in words, and whether equilibrium is excluded."""
    out = entropy.is_significant
    verdict = "out of equilibrium" if out else "equilibrium is not excluded"
    rate = entropy.rate
    return (
        f"Entropy production of a steady state: {rate.value:.3g} ± {rate.sd:.2g} (sd) "
        f"k_B per unit of time: {verdict}; current velocity {entropy.speed:.3g} (rms)."
    )


def _influence(analysis: Analysis) -> Blocks:
    rows = analysis.influence
    if not rows:
        return []
    most = max(rows, key=lambda row: row.force)
    changes = np.stack([row.change for row in rows])
    columns: dict[str, Callable[[TrajectoryEffect], Cell]] = {
        "trajectory": lambda row: row.trajectory,
        "leverage": lambda row: row.leverage,
        "Cook's distance": lambda row: row.cook,
        "change of the field (%)": lambda row: 100 * row.force,
        _final(analysis): lambda row: row.final,
    }
    return [
        Paragraph(
            f"Most influential: trajectory {most.trajectory}; without it the field "
            f"changes by {most.force:.2%}."
        ),
        influence_figure(changes, analysis.field, analysis.paths, units=analysis.units),
        Table.of(
            rows,
            columns,
            "Each trajectory: leverage, the number of parameters that it determines; "
            "Cook's distance; root-mean-square change of the field near the data "
            "without it, relative to that of the field; change of the final position "
            "of the reference rollout.",
            name="analysis-influence",
        ),
    ]


def _constants(analysis: Analysis) -> Blocks:
    rows = analysis.constants
    if not rows:
        return []
    slopes = {row.constant: row.change for row in rows}
    shown = {"path": analysis.all_paths, "units": analysis.units}
    columns: dict[str, Callable[[ConstantEffect], Cell]] = {
        "constant": lambda row: row.constant,
        "value": lambda row: row.value,
        "learned": lambda row: "yes" if row.learned else "no",
        "change of the field (%)": lambda row: 100 * row.force,
        _final(analysis): lambda row: row.final,
    }
    return [
        constants_figure(slopes, analysis.field, **shown),
        Table.of(
            rows,
            columns,
            "Each constant one percent larger: root-mean-square change of the field "
            "near the data, relative to that of the field, and change of the final "
            "position of the reference rollout.",
            name="analysis-constants",
        ),
    ]


def _final(analysis: Analysis) -> str:
    return heading("change of the final position", analysis.units.get("x", ""))


def growth_sentence(growth: LyapunovMap, time: str) -> str:
    """The growth of separations and the exponent in words; with the unit of time."""
    if not np.isfinite(growth.median):
        return "Separations of neighbouring starts: no finite growth."
    return (
        f"Separations of neighbouring starts grow by {growth.median:.3g} (median) "
        f"to {growth.greatest:.3g} (greatest) over {quantity(growth.horizon, time)}; "
        f"median finite-time Lyapunov exponent {growth.median_exponent:.2g} per "
        "unit of time."
    )


def _sobol(analysis: Analysis) -> Blocks:
    indices = analysis.sobol
    if indices is None:
        return []
    landmark = ", ".join(f"{value:.3g}" for value in analysis.landmark or ())
    caption = (
        f"Rollouts of trajectory {analysis.reference} with strengths varied by "
        f"± {analysis.relative:.0%} and the start by ± {analysis.shift:g}, uniformly "
        "and independently. Displacement is from the nominal final position, arrival "
        "means that it is at most the distance that counts as visited, and the least "
        "distance is to the highest point of the potential near the data, "
        f"({landmark})."
    )
    return [sobol_figure(indices, caption), _table_of(indices)]


def _table_of(indices: SobolIndices) -> Table:
    header = ["outcome", "factor"]
    for name in ("first order", "total"):
        header += [name, f"{name} from", f"{name} to"]
    rows = [
        (
            outcome,
            factor,
            *map(float, (indices.first[i, j], *indices.first_interval[i, j])),
            *map(float, (indices.total[i, j], *indices.total_interval[i, j])),
            float(indices.variance[i]),
        )
        for i, outcome in enumerate(indices.outcomes)
        for j, factor in enumerate(indices.factors)
    ]
    level = f"{100 * indices.confidence:.0f} %"
    return Table(
        (*header, "variance of the outcome"),
        rows,
        f"Sobol' indices with {level} bootstrap intervals.",
        name="analysis-sobol",
    )
