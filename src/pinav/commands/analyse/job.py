"""`pinav analyse`: maps, parts and sensitivities of what a run has learned.

Each part is a function of the fitted run; `analyse` puts their results together.
"""

import dataclasses
from operator import attrgetter
from pathlib import Path

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from pinav.analysis import (
    Influence,
    RolloutStudy,
    SobolIndices,
    helmholtz_split,
    influence,
    lyapunov_map,
    rotational_fractions,
    sampled_forces,
)
from pinav.commands.analyse.metrics import (
    AnalysisMetrics,
    ConstantEffect,
    HelmholtzMetrics,
    InfluenceRow,
    LyapunovMetrics,
    SobolRow,
)
from pinav.commands.analyse.settings import AnalyseOptions, AnalyseSettings
from pinav.commands.command import CommandResult
from pinav.commands.fitted_run import EvidenceResult, FittedRun
from pinav.dynamics import OverdampedSwimmer, Swimmer, commanded, takes_commands
from pinav.errors import FitError, InputError
from pinav.evaluation import FieldMap, check_planar, field_map
from pinav.fitting.environments.catalogue import CONSTANTS
from pinav.forces import (
    AbstractLearnedForce,
    KernelPotential,
    LinearDrag,
    MagneticPropulsion,
    NeuralPotential,
)
from pinav.runs import RunFolder

ANALYSIS_FILE, ARRAYS_FILE = "analysis.json", "analysis.npz"

LYAPUNOV_POINTS = 25
"""Starts along each side of the map of Lyapunov exponents."""

COMMANDED_SAMPLES = 250
"""Samples of the reference trajectory that a model driven by commands is rolled out."""

NO_POSTERIOR = "the run has no posterior; fit with --recipe bayes"

Arrays = dict[str, np.ndarray]


@dataclasses.dataclass(frozen=True)
class Subject:
    """The run that is analysed, as all parts need it.

    Attributes:
        run: the fitted run.
        model: its swimmer with the learned force.
        field: the learned force on a grid.
        settings: of the analysis.
    """

    run: FittedRun
    model: Swimmer | OverdampedSwimmer
    field: FieldMap
    settings: AnalyseSettings

    @property
    def start(self) -> Float[np.ndarray, " state"]:
        """Start of the reference trajectory."""
        return self.run.start(self.settings.reference)

    @property
    def times(self) -> Float[np.ndarray, " time"]:
        """Times of the reference trajectory [T]; its beginning under commands.

        Every jump of a command ends a step of the solver, for each start of a map.
        """
        index = self.settings.reference
        times = self.run.data.times[index][: self.run.data.lengths[index]]
        return times[:COMMANDED_SAMPLES] if takes_commands(self.run.model) else times

    @property
    def near(self) -> np.ndarray:
        """Grid points near the data."""
        return self.field.distance <= self.field.regions.near

    @property
    def grid(self) -> Float[np.ndarray, "point 2"]:
        """The points of the grid."""
        grid = np.stack(np.meshgrid(self.field.x, self.field.y), axis=-1)
        return grid.reshape(-1, 2)


def analyse(settings: AnalyseSettings, run: Path) -> AnalysisMetrics:
    """Analyse a fitted run and write the results into its folder.

    Raises:
        InputError: the folder holds no finished fit of a planar force, or there is no
            trajectory of the number that was asked for.
    """
    settings.check()
    fitted = FittedRun.open(run)
    with tqdm(total=4, desc="analyse", unit="part") as bar:
        subject = _subject(settings, fitted)
        arrays = {n: getattr(subject.field, n) for n in ("x", "y", "force", "distance")}
        split, split_arrays = split_force(subject)
        bar.update()
        significance, sd_arrays, sd = judge_significance(subject)
        bar.update()
        effects = trace_influence(subject)
        bar.update()
        rollouts = vary_rollouts(subject, split_arrays["potential"])
        bar.update()
    arrays |= split_arrays | sd_arrays | effects.arrays | rollouts.arrays
    left_out = () if fitted.evidence else (f"standard deviations: {NO_POSTERIOR}",)
    learned_potential = isinstance(
        subject.model.environment, KernelPotential | NeuralPotential
    )
    metrics = AnalysisMetrics(
        model=fitted.choice.name,
        posterior=fitted.evidence is not None,
        order=fitted.system.order,
        settings=msgspec.to_builtins(settings),
        helmholtz=msgspec.structs.replace(split, sd=sd),
        potential="learned" if learned_potential else "of the gradient part",
        left_out=(*left_out, *effects.left_out, *rollouts.left_out),
        above_two_sd=significance,
        influence=effects.influence,
        constants=effects.constants,
        lyapunov=rollouts.lyapunov,
        sobol=rollouts.sobol,
        landmark=rollouts.landmark,
    )
    _write(fitted.folder, metrics, arrays)
    return metrics


def _subject(settings: AnalyseSettings, run: FittedRun) -> Subject:
    model = run.model
    if not isinstance(model, Swimmer | OverdampedSwimmer) or not isinstance(
        model.environment, AbstractLearnedForce
    ):
        raise InputError(
            f"{run.folder.path}: its model has no learned force of the environment; "
            "fit a kernel or neural model"
        )
    if settings.reference >= len(run.data):
        raise InputError(
            f"--reference: expected 0 to {len(run.data) - 1}, a trajectory of "
            f"{run.folder.path}, got {settings.reference}"
        )
    check_planar(run.data)
    model = commanded(model, run.data.trajectory(settings.reference))
    field = field_map(model.environment, run.data, points=settings.points)
    return Subject(run, model, field, settings)


def split_force(subject: Subject) -> tuple[HelmholtzMetrics, Arrays]:
    """Gradient and rotational part of the force, with the potential."""
    field, force = subject.field, subject.model.environment
    split = helmholtz_split(field)
    metrics = HelmholtzMetrics(
        reach=field.regions.near,
        rotational=split.rotational_fraction,
        gradient=split.gradient_fraction,
        least=split.least_fraction,
        greatest=split.greatest_fraction,
        misfit=split.misfit,
    )
    names = ("gradient", "rotational", "stream", "region", "potential")
    arrays = {f"split/{name}": getattr(split, name) for name in names}
    arrays["potential"] = split.potential
    if isinstance(force, KernelPotential | NeuralPotential):
        at = jax.vmap(lambda x: force.potential(0.0, x))
        values = np.asarray(at(jnp.asarray(subject.grid)), float)
        arrays["potential"] = values.reshape(field.distance.shape)
    return metrics, arrays


def judge_significance(
    subject: Subject,
) -> tuple[dict[str, float] | None, Arrays, float | None]:
    """Fraction of each region where the force is significant, by the posterior.

    Returns:
        The fractions, the standard deviations on the grid, and the standard deviation
        of the rotational fraction.
    """
    run, field = subject.run, subject.field
    if run.posterior is None:
        return None, {}, None
    sd = run.force_sd(field)
    size = np.linalg.norm(field.force, axis=-1)
    significant = size > 2.0 * np.linalg.norm(sd, axis=-1)
    fractions = {
        name: float(significant[mask].mean())
        for name, mask in field.regions.masks(field.distance).items()
        if name != "unvisited" and mask.any()
    }
    key = jax.random.key(subject.settings.seed)
    forces = sampled_forces(run.posterior, field, subject.settings.draws, key=key)
    return fractions, {"sd": sd}, float(rotational_fractions(field, forces).std())


@dataclasses.dataclass(frozen=True)
class Effects:
    """The influence of trajectories and constants, as far as it could be found.

    Attributes:
        influence: of each trajectory.
        constants: effect of each constant.
        arrays: changes of the force.
        left_out: what could not be found, and why.
    """

    influence: tuple[InfluenceRow, ...] | None = None
    constants: tuple[ConstantEffect, ...] | None = None
    arrays: Arrays = dataclasses.field(default_factory=dict)
    left_out: tuple[str, ...] = ()


def trace_influence(subject: Subject) -> Effects:
    """Influence of each trajectory and each constant on force and final position."""
    what = "influence of trajectories and constants"
    evidence = subject.run.evidence
    if evidence is None:
        return Effects(left_out=(f"{what}: {NO_POSTERIOR}",))
    if "diffusion" in evidence.constants:
        reason = "it is defined for fits of trajectories, not of stochastic increments"
        return Effects(left_out=(f"{what}: {reason}",))
    if takes_commands(subject.run.model):
        reason = "it is defined for fits without commands and wandering velocity"
        return Effects(left_out=(f"{what}: {reason}",))
    try:
        effects = _influence(subject, evidence)
    except (InputError, FitError) as error:
        return Effects(left_out=(f"{what}: {error}",))
    changes = effects.force_changes(subject.grid, effects.removals)
    changes = changes.reshape(-1, *subject.field.force.shape)
    final = effects.final_changes(subject.start, subject.times, effects.removals)
    size = _rms(subject.field.force[subject.near])
    rows = tuple(
        InfluenceRow(
            trajectory=index,
            leverage=float(effects.leverages[index]),
            cook=float(effects.distances[index]),
            force=_rms(changes[index][subject.near]) / size,
            final=float(np.linalg.norm(final[index, :2])),
        )
        for index in range(len(changes))
    )
    arrays = {"influence": changes}
    if not effects.constants:
        left_out = ("influence of constants: the physics has none",)
        return Effects(rows, None, arrays, left_out)
    constants, slopes = _constant_effects(subject, effects, size)
    return Effects(rows, constants, arrays | slopes)


def _influence(subject: Subject, evidence: EvidenceResult) -> Influence:
    model, run = subject.model, subject.run
    has = {
        "damping": isinstance(model, Swimmer) and isinstance(model.drag, LinearDrag),
        "gain": isinstance(model.propulsion, MagneticPropulsion),
    }
    constants = {n: attrgetter(path) for n, path in CONSTANTS.items() if has.get(n)}
    return influence(
        model,
        run.data,
        evidence.states,
        evidence.hyperparameters,
        learn=run.choice.constants,
        constants=constants,
        kernels=evidence.process,
    )


def _constant_effects(
    subject: Subject, effects: Influence, size: float
) -> tuple[tuple[ConstantEffect, ...], Arrays]:
    """Change of force and final position per percent of each constant."""
    rows, arrays = [], {}
    for name, change in effects.constants.items():
        value = float(attrgetter(CONSTANTS[name])(subject.model))
        percent = 0.01 * value * change[None]
        moved = effects.force_changes(subject.grid, percent)[0]
        moved = moved.reshape(subject.field.force.shape)
        final = effects.final_changes(subject.start, subject.times, percent)[0, :2]
        arrays[f"constant/{name}"] = moved
        row = ConstantEffect(
            constant=name,
            value=value,
            learned=name in subject.run.choice.learn,
            force=_rms(moved[subject.near]) / size,
            final=float(np.linalg.norm(final)),
        )
        rows.append(row)
    return tuple(rows), arrays


@dataclasses.dataclass(frozen=True)
class RolloutSensitivity:
    """The dependence of a rollout on its start and on all parameters.

    Attributes:
        lyapunov: exponents over starts.
        arrays: their map.
        sobol: indices of the reference rollout.
        landmark: highest point of the potential near the data [L].
        left_out: what could not be found, and why.
    """

    lyapunov: LyapunovMetrics
    arrays: Arrays
    sobol: tuple[SobolRow, ...] | None = None
    landmark: tuple[float, float] | None = None
    left_out: tuple[str, ...] = ()


def vary_rollouts(
    subject: Subject, potential: Float[np.ndarray, "rows columns"]
) -> RolloutSensitivity:
    """Dependence of the reference rollout on its start and on all parameters.

    Args:
        subject: the run.
        potential: on its grid; its top near the data is the landmark.
    """
    lyapunov, arrays = _lyapunov(subject)
    field = subject.field
    top = np.where(subject.near, potential, -np.inf).argmax()
    row, column = np.unravel_index(top, potential.shape)
    landmark = np.array([field.x[column], field.y[row]])
    plain = RolloutSensitivity(lyapunov, arrays)
    if not isinstance(subject.model, Swimmer):
        reason = "they are varied for swimmers with inertia alone"
        return dataclasses.replace(plain, left_out=(f"Sobol' indices: {reason}",))
    study = RolloutStudy(
        subject.model, subject.start, subject.times, landmark, field.regions.visited
    )
    settings = subject.settings
    factors = study.factors(relative=settings.relative, shift=settings.shift)
    try:
        indices = study.indices(factors, samples=settings.samples, seed=settings.seed)
    except InputError as error:
        return dataclasses.replace(plain, left_out=(f"Sobol' indices: {error}",))
    place = (float(landmark[0]), float(landmark[1]))
    return dataclasses.replace(plain, sobol=_sobol_rows(indices), landmark=place)


def _lyapunov(subject: Subject) -> tuple[LyapunovMetrics, Arrays]:
    x, y = (
        np.linspace(axis[0], axis[-1], LYAPUNOV_POINTS)
        for axis in (subject.field.x, subject.field.y)
    )
    velocity = subject.start[2:]
    growth = lyapunov_map(
        subject.model,
        x,
        y,
        subject.times,
        velocity=(lambda _: velocity) if len(velocity) else None,
    )
    names = ("x", "y", "separation", "final")
    metrics = LyapunovMetrics(
        horizon=growth.horizon,
        median=float(np.nanmedian(growth.separation)),
        greatest=float(np.nanmax(growth.separation)),
        exponent=float(np.nanmedian(growth.exponent)),
    )
    return metrics, {f"lyapunov/{name}": getattr(growth, name) for name in names}


def _rms(values: Float[np.ndarray, "... 2"]) -> float:
    return float(np.sqrt(np.mean(np.sum(values**2, axis=-1))))


def _sobol_rows(indices: SobolIndices) -> tuple[SobolRow, ...]:
    return tuple(
        SobolRow(
            outcome=outcome,
            factor=factor,
            first=float(indices.first[i, j]),
            first_low=float(indices.first_interval[i, j, 0]),
            first_high=float(indices.first_interval[i, j, 1]),
            total=float(indices.total[i, j]),
            total_low=float(indices.total_interval[i, j, 0]),
            total_high=float(indices.total_interval[i, j, 1]),
            variance=float(indices.variance[i]),
        )
        for i, outcome in enumerate(indices.outcomes)
        for j, factor in enumerate(indices.factors)
    )


def _write(folder: RunFolder, metrics: AnalysisMetrics, arrays: Arrays) -> None:
    """Write everything; `analysis.json` last, when all else is there."""
    folder.write_arrays(ARRAYS_FILE, arrays)
    for name in ("influence", "constants", "sobol"):
        if rows := getattr(metrics, name):
            table = [msgspec.structs.astuple(row) for row in rows]
            header = rows[0].__struct_fields__
            folder.write_table(f"analysis-{name}.csv", header, table)
    folder.write_metrics(ANALYSIS_FILE, metrics)


def text(metrics: AnalysisMetrics) -> str:
    """The findings for a terminal."""
    lines = [rotation_sentence(metrics.helmholtz)]
    if metrics.above_two_sd is not None:
        parts = ", ".join(f"{k} {v:.0%}" for k, v in metrics.above_two_sd.items())
        lines.append(f"force above two standard deviations: {parts} of the region")
    if metrics.influence:
        most = max(metrics.influence, key=lambda row: row.force)
        lines.append(
            f"most influential: trajectory {most.trajectory}; without it the force "
            f"changes by {most.force:.2%}"
        )
    for row in metrics.constants or ():
        lines.append(
            f"{row.constant} one percent larger: force {row.force:.2%}, final "
            f"position {row.final:.3g}"
        )
    growth = metrics.lyapunov
    lines.append(
        f"separations of neighbouring starts grow by {growth.median:.3g} (median) to "
        f"{growth.greatest:.3g} (greatest) over {growth.horizon:.4g}; median "
        f"finite-time Lyapunov exponent {growth.exponent:.3g}"
    )
    return "\n".join([*lines, *(f"left out: {line}" for line in metrics.left_out)])


def rotation_sentence(parts: HelmholtzMetrics) -> str:
    """The rotational fraction in words, and what its bounds mean."""
    spread = "" if parts.sd is None else f" ± {parts.sd:.2%} (sd)"
    return (
        f"rotational part: {parts.rotational:.2%}{spread} of the squared force within "
        f"{parts.reach:g} of the data. Near the data alone some fields are gradient "
        "and rotational at once (harmonic fields): counted as gradient they leave "
        f"{parts.least:.2%}, counted as rotational {parts.greatest:.2%}"
    )


def run(options: AnalyseOptions) -> CommandResult:
    """Analyse as the command line does."""
    metrics = analyse(options.settings, options.run)
    return CommandResult(metrics, text(metrics), RunFolder.open(options.run))
