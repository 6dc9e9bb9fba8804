"""`pinav analyse`: maps, parts and sensitivities of what a run has learned.

Each part is a function of the fitted run; `analyse` puts their results together.
"""

import dataclasses
from operator import attrgetter
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import msgspec
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from tqdm import tqdm

from pinav.analysis import (
    Influence,
    entropy_production,
    helmholtz_split,
    influence,
    rotational_fractions,
    sample_forces,
)
from pinav.commands.analyse.metrics import (
    AnalysisMetrics,
    ConstantEffect,
    EntropyMetrics,
    HelmholtzMetrics,
    InfluenceRow,
)
from pinav.commands.analyse.rollouts import vary_rollouts
from pinav.commands.analyse.settings import AnalyseOptions, AnalyseSettings
from pinav.commands.analyse.subject import Arrays, Subject
from pinav.commands.command import CommandResult
from pinav.commands.evidence_file import EvidenceResult
from pinav.commands.fitted_run import FittedRun
from pinav.dynamics import OverdampedSwimmer, Swimmer, drive_by_commands, takes_commands
from pinav.errors import FitError, InputError
from pinav.evaluation import check_planar, field_map
from pinav.fitting.environments.choice import CONSTANTS
from pinav.forces import (
    KernelTensor,
    LinearDrag,
    MagneticPropulsion,
    ZeroForce,
    as_learned_force,
)
from pinav.runs import RunFolder

ANALYSIS_FILE, ARRAYS_FILE = "analysis.json", "analysis.npz"

NO_POSTERIOR = "the run has no posterior; fit with --recipe bayes"


def analyse(settings: AnalyseSettings, fitted: FittedRun) -> AnalysisMetrics:
    """Analyse a fitted run and write the results into its folder.

    Raises:
        InputError: the run is no fit of a planar force, or there is no trajectory of
            the number that was asked for.
    """
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
    entropy, currents, entropy_left_out = produce_entropy(fitted)
    arrays |= split_arrays | sd_arrays | effects.arrays | rollouts.arrays | currents
    left_out = () if fitted.evidence else (f"standard deviations: {NO_POSTERIOR}",)
    metrics = AnalysisMetrics(
        model=fitted.choice.name,
        posterior=fitted.evidence is not None,
        order=fitted.system.order,
        settings=msgspec.to_builtins(settings),
        helmholtz=msgspec.structs.replace(split, sd=sd),
        potential="learned" if subject.has_potential else "of the gradient part",
        left_out=(
            *(*left_out, *effects.left_out, *rollouts.left_out, *entropy_left_out),
        ),
        above_two_sd=significance,
        influence=effects.influence,
        constants=effects.constants,
        lyapunov=rollouts.lyapunov,
        sobol=rollouts.sobol,
        landmark=rollouts.landmark,
        entropy=entropy,
    )
    _write(fitted.folder, metrics, arrays)
    return metrics


def _subject(settings: AnalyseSettings, run: FittedRun) -> Subject:
    model = run.model
    is_swimmer = isinstance(model, Swimmer | OverdampedSwimmer)
    if not is_swimmer or as_learned_force(model.environment) is None:
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
    model = drive_by_commands(model, run.data.trajectory(settings.reference))
    field = field_map(model.environment, run.data, points=settings.points)
    return Subject(run, model, field, settings)


def split_force(subject: Subject) -> tuple[HelmholtzMetrics, Arrays]:
    """Gradient and rotational part of the force, with the potential."""
    field = subject.field
    force: Any = subject.model.environment
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
    if subject.has_potential:
        values = np.asarray(_potentials(force, subject.grid), float)
        arrays["potential"] = values.reshape(field.distance.shape)
    return metrics, arrays


@eqx.filter_jit
def _potentials(
    force: Any, points: Float[ArrayLike, "point 2"]
) -> Float[Array, " point"]:
    return jax.vmap(lambda x: force.potential(0.0, x))(jnp.asarray(points))


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
    forces = sample_forces(run.posterior, field, subject.settings.draws, key=key)
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


MOST_SAMPLES = 4000
"""Samples at most over which entropy production is a mean."""


def produce_entropy(
    run: FittedRun,
) -> tuple[EntropyMetrics | None, Arrays, tuple[str, ...]]:
    """Entropy production of thermal motion, with the current at the samples.

    Args:
        run: of a fit.

    Returns:
        The numbers, the arrays, and what is left out; nothing for other motion.
    """
    evidence = run.evidence
    if evidence is None or "diffusion" not in evidence.constants:
        return None, {}, ()
    model: Any = run.model
    if not isinstance(model.propulsion, ZeroForce):
        reason = "the swimmer is driven by its propulsion, which is no steady state"
        return None, {}, (f"entropy production: {reason}",)
    if model.environment.is_conservative:
        reason = "the model is a potential, which makes none; fit --model kernel-force"
        return None, {}, (f"entropy production: {reason}",)
    data = run.data
    samples = data.positions[data.observed.all(axis=-1)]
    samples = samples[:: max(len(samples) // MOST_SAMPLES, 1)]
    number = evidence.constants["diffusion"]
    field = np.full(samples.shape, number.value)
    if isinstance(model.mobility, KernelTensor) and run.system.thermal_energy:
        mobility = jax.vmap(model.mobility.diagonal)(jnp.asarray(samples))
        field = float(run.system.thermal_energy) * np.asarray(mobility)
    try:
        entropy = entropy_production(
            evidence.posterior, samples, field, number.sd / number.value
        )
    except InputError as error:
        return None, {}, (str(error),)
    arrays = {"entropy/positions": samples, "entropy/current": entropy.current}
    speed = _rms(entropy.current)
    return EntropyMetrics(entropy.rate.value, entropy.rate.sd, speed), arrays, ()


def _rms(values: Float[np.ndarray, "... 2"]) -> float:
    return float(np.sqrt(np.mean(np.sum(values**2, axis=-1))))


def _write(folder: RunFolder, metrics: AnalysisMetrics, arrays: Arrays) -> None:
    """Write everything; `analysis.json` last, when all else is there."""
    folder.write_arrays(ARRAYS_FILE, arrays)
    for name in ("influence", "constants", "sobol"):
        if rows := getattr(metrics, name):
            table = [msgspec.structs.astuple(row) for row in rows]
            header = rows[0].__struct_fields__
            folder.write_table(f"analysis-{name}.csv", header, table)
    folder.write_metrics(ANALYSIS_FILE, metrics)


def run(options: AnalyseOptions) -> CommandResult:
    """Analyse as the command line does."""
    options.settings.check()
    fitted = FittedRun.open(options.run)
    metrics = analyse(options.settings, fitted)
    return CommandResult(metrics, metrics.text(fitted.data.units), fitted.folder)
