"""Sections of the report on what `pinav analyse` found, from its saved results."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from pinav.analysis import HelmholtzSplit, LyapunovMap, SobolIndices
from pinav.commands.analyse.job import ANALYSIS_FILE, ARRAYS_FILE
from pinav.commands.analyse.metrics import (
    AnalysisMetrics,
    ConstantEffect,
    InfluenceRow,
    SobolRow,
)
from pinav.commands.force_units import units_of
from pinav.commands.system_choice import read_system_of
from pinav.evaluation import FieldMap, default_regions
from pinav.figures import (
    constants_figure,
    helmholtz_figure,
    influence_figure,
    lyapunov_figure,
    potential_map,
    sobol_figure,
    trust_map,
)
from pinav.figures.analysis import one_legend
from pinav.figures.style import new_figure, title_panel
from pinav.report import Cell, Image, Paragraph, Section, Table, capitalise, quantity
from pinav.report.images import Figures
from pinav.runs import RunFolder
from pinav.trajectories import load

Content = list[Paragraph | Image | Table]


@dataclasses.dataclass(frozen=True)
class Results:
    """The saved results of an analysis.

    Attributes:
        metrics: the numbers.
        arrays: maps and curves.
        field: the learned force.
        paths: observed positions of each trajectory.
        units: of the channels, with the order of the dynamics.
    """

    metrics: AnalysisMetrics
    arrays: Mapping[str, np.ndarray]
    field: FieldMap
    paths: Sequence[Float[np.ndarray, "_ 2"]]
    units: Mapping[str, str]

    @classmethod
    def read(cls, folder: RunFolder) -> "Results":
        """The results in a run."""
        metrics = folder.read_metrics(ANALYSIS_FILE, AnalysisMetrics)
        arrays = folder.read_arrays(ARRAYS_FILE)
        data = load(folder.path / "data.npz")
        x, y, force, distance = (arrays[n] for n in ("x", "y", "force", "distance"))
        field = FieldMap(x, y, force, distance, default_regions(data))
        paths = [np.where(p.observed[:, :2], p.states[:, :2], np.nan) for p in data]
        units = units_of(data, read_system_of(folder))
        return cls(metrics, arrays, field, paths, units)

    @property
    def all_paths(self) -> Float[np.ndarray, "_ 2"]:
        """All paths in one array, a row of NaN between two."""
        gap = np.full((1, 2), np.nan)
        return np.concatenate([part for path in self.paths for part in (path, gap)])


def analysis_sections(folder: RunFolder) -> list[Section]:
    """Maps of what was learned, and what it depends on; nothing without an analysis."""
    if not folder.has(ANALYSIS_FILE):
        return []
    results, figures = Results.read(folder), Figures(folder.path)
    sections = [
        Section(
            "What was learned",
            [*_parts(results, figures), _potential(results, figures)],
        )
    ]
    if results.metrics.entropy is not None:
        paragraph = Paragraph(f"{capitalise(results.metrics.entropy.sentence())}.")
        sections.append(Section("Out of equilibrium", [paragraph]))
    if results.metrics.influence:
        content = [*_influence(results, figures), *_constants(results, figures)]
        sections.append(Section("What the field depends on", content))
    content = [_lyapunov(results, figures), *_sobol(results, figures)]
    sections.append(Section("What a rollout depends on", content))
    if results.metrics.left_out:
        lines = [Paragraph(line) for line in results.metrics.left_out]
        sections.append(Section("Left out of the analysis", lines))
    return sections


def _parts(results: Results, figures: Figures) -> Content:
    """Gradient and rotational part."""
    parts, arrays = results.metrics.helmholtz, results.arrays
    split = HelmholtzSplit(
        gradient=arrays["split/gradient"],
        rotational=arrays["split/rotational"],
        potential=arrays["split/potential"],
        stream=arrays["split/stream"],
        region=arrays["split/region"],
        rotational_fraction=parts.rotational,
        least_fraction=parts.least,
        greatest_fraction=parts.greatest,
        misfit=parts.misfit,
    )
    figure = helmholtz_figure(
        split,
        results.field,
        spread=parts.sd,
        path=results.all_paths,
        units=results.units,
    )
    image = figures.image(
        "analysis-helmholtz",
        figure,
        "Helmholtz split of the learned field, by least squares in the region within "
        f"{quantity(parts.reach, results.units.get('x', ''))} of the data. Fractions "
        "are of the square of the field there. "
        "Harmonic fields are both; they are shared equally.",
        alt="Gradient part and rotational part of the learned field",
    )
    percent = [100 * v for v in (parts.rotational, parts.least, parts.greatest)]
    spread = "–" if parts.sd is None else 100 * parts.sd
    table = Table(
        ("part", "fraction (%)", "least (%)", "greatest (%)", "sd (%)"),
        [("rotational", *percent, spread)],
        "Least: harmonic fields all count as gradients, so that this is what no "
        "potential explains. Greatest: they all count as rotational. sd: over "
        "posterior samples.",
    )
    return [Paragraph(f"{capitalise(parts.sentence(results.units))}."), image, table]


def _potential(results: Results, figures: Figures) -> Image:
    """The potential, and the signal to noise of the force."""
    options = {"path": results.all_paths, "units": results.units}
    sd = results.arrays.get("sd")
    figure = new_figure(3.8 if sd is None else 7.5, 4.6)
    axes = np.ravel(figure.subplots(1, 1 if sd is None else 2))
    potential = results.arrays["potential"]
    potential_map(potential, results.field, ax=axes[0], **options)
    title_panel(axes[0], f"(a) potential, {results.metrics.potential}")
    caption = "Potential up to a constant."
    if sd is not None:
        trust_map(results.field, sd, ax=axes[1], **options)
        title_panel(axes[1], "(b) signal to noise")
        caption += (
            " Right: size of the field over its standard deviation; outside the "
            "marked line it is not significantly different from zero. Away from the "
            "data the standard deviation is that of the assumed prior and is not to "
            "be trusted."
        )
    one_legend(figure, axes)
    alt = "Potential, and where the field is known"
    return figures.image("analysis-potential", figure, caption, alt=alt)


def _influence(results: Results, figures: Figures) -> Content:
    """The influence of each trajectory."""
    figure = influence_figure(
        results.arrays["influence"], results.field, results.paths, units=results.units
    )
    image = figures.image(
        "analysis-influence",
        figure,
        "Change of the learned field where the trajectory that is drawn is left out of "
        "the fit, to first order, the hyperparameters held.",
        alt="Change of the field where one trajectory is left out",
    )
    columns: dict[str, Callable[[InfluenceRow], Cell]] = {
        "trajectory": lambda row: row.trajectory,
        "leverage": lambda row: row.leverage,
        "Cook's distance": lambda row: row.cook,
        "change of the field (%)": lambda row: 100 * row.force,
        "change of the final position": lambda row: row.final,
    }
    rows = results.metrics.influence or ()
    return [image, Table.of(rows, columns, INFLUENCE_CAPTION)]


INFLUENCE_CAPTION = (
    "Each trajectory: leverage, the number of parameters that it determines; Cook's "
    "distance; root-mean-square change of the field near the data without it, relative "
    "to that of the field; change of the final position of the reference rollout."
)


def _constants(results: Results, figures: Figures) -> Content:
    """The effect of constants of the physics."""
    slopes = {
        name.removeprefix("constant/"): values
        for name, values in results.arrays.items()
        if name.startswith("constant/")
    }
    if not slopes:
        return []
    options = {"path": results.all_paths, "units": results.units}
    image = figures.image(
        "analysis-constants",
        constants_figure(slopes, results.field, **options),
        "Change of the learned field where a constant is one percent larger and "
        "everything else is fitted anew.",
        alt="Change of the field with known constants",
    )
    columns: dict[str, Callable[[ConstantEffect], Cell]] = {
        "constant": lambda row: row.constant,
        "value": lambda row: row.value,
        "learned": lambda row: "yes" if row.learned else "no",
        "change of the field (%)": lambda row: 100 * row.force,
        "change of the final position": lambda row: row.final,
    }
    rows = results.metrics.constants or ()
    return [image, Table.of(rows, columns, CONSTANTS_CAPTION)]


CONSTANTS_CAPTION = (
    "Each constant one percent larger: root-mean-square change of the field near the "
    "data, relative to that of the field, and change of the final position of the "
    "reference rollout."
)


def _lyapunov(results: Results, figures: Figures) -> Image:
    """Growth of separations over starts."""
    index = int(results.metrics.settings["reference"])
    names = ("x", "y", "separation", "final")
    exponents = LyapunovMap(
        *(results.arrays[f"lyapunov/{name}"] for name in names),
        horizon=results.metrics.lyapunov.horizon,
    )
    return figures.image(
        "analysis-lyapunov",
        lyapunov_figure(exponents, path=results.paths[index], units=results.units),
        "Growth of the separation of two rollouts of the model that start side by "
        f"side, with the velocity of trajectory {index} at its start; its logarithm "
        "over the time is the finite-time Lyapunov exponent. Ridges separate starts "
        "with different fates.",
        alt="Growth of separations over starts",
        width=0.6,
    )


def _sobol(results: Results, figures: Figures) -> Content:
    """Global sensitivity of a rollout."""
    rows = results.metrics.sobol
    if not rows:
        return []
    image = figures.image(
        "analysis-sobol",
        sobol_figure(_indices(rows)),
        _sobol_caption(results.metrics),
        alt="Sobol' indices of the outcome of a rollout",
    )
    header = ("outcome", "factor", "first order", "95 % interval", "total")
    cells = [
        (
            row.outcome,
            row.factor,
            row.first,
            _interval(row.first_low, row.first_high),
            row.total,
            _interval(row.total_low, row.total_high),
            row.variance,
        )
        for row in rows
    ]
    header = (*header, "95 % interval", "variance of the outcome")
    table = Table(header, cells, "Sobol' indices with 95 % bootstrap intervals.")
    return [image, table]


def _interval(low: float | None, high: float | None) -> str:
    return "–" if low is None or high is None else f"{low:.2f} to {high:.2f}"


def _sobol_caption(metrics: AnalysisMetrics) -> str:
    settings = metrics.settings
    landmark = ", ".join(f"{value:.3g}" for value in metrics.landmark or ())
    return (
        f"Rollouts of trajectory {settings['reference']} with strengths varied by "
        f"± {settings['relative']:.0%} and the start by ± {settings['shift']:g}, "
        "uniformly and independently. Displacement is from the nominal final position, "
        "arrival means that it is at most the distance that counts as visited, and the "
        f"least distance is to the highest point of the potential near the data, "
        f"({landmark})."
    )


def _indices(rows: Sequence[SobolRow]) -> SobolIndices:
    outcomes = list(dict.fromkeys(row.outcome for row in rows))
    factors = list(dict.fromkeys(row.factor for row in rows))
    shape = len(outcomes), len(factors)

    def column(name: str) -> np.ndarray:
        values = [getattr(row, name) for row in rows]
        values = [np.nan if value is None else value for value in values]
        return np.array(values, float).reshape(shape)

    def interval(name: str) -> np.ndarray:
        return np.stack([column(f"{name}_{end}") for end in ("low", "high")], axis=-1)

    return SobolIndices(
        factors=tuple(factors),
        outcomes=tuple(outcomes),
        first=column("first"),
        first_interval=interval("first"),
        total=column("total"),
        total_interval=interval("total"),
        confidence=0.95,
        variance=column("variance")[:, 0],
    )
