"""`pinav analyse`: maps, parts and sensitivities of what a run has learned.

Each part is a function of the fitted run that returns a result of the library, or says
why there is none; `analyse` puts them together.
"""

from collections.abc import Callable
from operator import attrgetter
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from tqdm import tqdm

from pinav.analysis import (
    EntropyProduction,
    Influence,
    entropy_production,
    helmholtz_split,
    influence,
    rotational_fractions,
    sample_forces,
)
from pinav.commands.analyse import ANALYSE
from pinav.commands.analyse.result import (
    Analysis,
    ConstantEffect,
    Doubt,
    TrajectoryEffect,
)
from pinav.commands.analyse.rollouts import vary_parameters, vary_starts
from pinav.commands.analyse.settings import AnalyseOptions, AnalyseSettings
from pinav.commands.analyse.subject import Subject
from pinav.commands.command import CommandResult
from pinav.commands.force_units import units_of
from pinav.commands.results import keep
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
from pinav.learning.evidence import Evidence
from pinav.learning.learned import Learned

Part = TypeVar("Part")

NO_POSTERIOR = "the run has no posterior; fit with --recipe bayes"


def analyse(settings: AnalyseSettings, run: Learned) -> Analysis:
    """Analyse a fitted run.

    Raises:
        InputError: the run is no fit of a planar force, or there is no trajectory of
            the number that was asked for.
    """
    left_out: list[str] = []

    def attempt(what: str, part: Callable[[], Part]) -> Part | None:
        try:
            return part()
        except (InputError, FitError) as error:
            left_out.append(f"{what}: {str(error).removeprefix(f'{what}: ')}")
            return None

    with tqdm(total=4, desc="analyse", unit="part") as bar:
        subject = _subject(settings, run)
        field = subject.field
        split = helmholtz_split(field)
        potential = split.potential
        if subject.has_potential:
            values = _potentials(subject.model.environment, subject.grid)
            potential = np.asarray(values, float).reshape(field.distance.shape)
        bar.update()
        doubt = attempt("standard deviations", lambda: judge_significance(subject))
        bar.update()
        effects = attempt(
            "influence of trajectories and constants", lambda: trace_influence(subject)
        )
        constants = effects and attempt(
            "influence of constants", lambda: constant_effects(subject, effects)
        )
        bar.update()
        lyapunov, landmark = vary_starts(subject), subject.top_of(potential)
        sobol = attempt("Sobol' indices", lambda: vary_parameters(subject, landmark))
        bar.update()
    entropy = None
    if is_thermal(run):
        entropy = attempt("entropy production", lambda: produce_entropy(run))
    states = zip(run.data.observed[..., :2], run.data.states[..., :2], strict=True)
    return Analysis(
        model=run.choice.name,
        settings=settings,
        units=dict(units_of(run.data, run.system)),
        paths=tuple(np.where(observed, places, np.nan) for observed, places in states),
        field=field,
        split=split,
        potential=potential,
        is_potential_learned=subject.has_potential,
        lyapunov=lyapunov,
        doubt=doubt,
        influence=trajectory_effects(subject, effects) if effects else (),
        constants=constants or (),
        sobol=sobol,
        landmark=None if sobol is None else (float(landmark[0]), float(landmark[1])),
        entropy=entropy,
        left_out=tuple(left_out),
    )


def _subject(settings: AnalyseSettings, run: Learned) -> Subject:
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


@eqx.filter_jit
def _potentials(
    force: Any, points: Float[ArrayLike, "point 2"]
) -> Float[Array, " point"]:
    return jax.vmap(lambda x: force.potential(0.0, x))(jnp.asarray(points))


def judge_significance(subject: Subject) -> Doubt:
    """Where the force is significant, by the posterior.

    Raises:
        InputError: the run has none.
    """
    run, field = subject.run, subject.field
    if run.posterior is None:
        raise InputError(NO_POSTERIOR)
    sd = run.force_sd(field)
    size = np.linalg.norm(field.force, axis=-1)
    significant = size > 2.0 * np.linalg.norm(sd, axis=-1)
    key = jax.random.key(subject.settings.seed)
    forces = sample_forces(run.posterior, field, subject.settings.draws, key=key)
    return Doubt(
        sd=sd,
        rotational=float(rotational_fractions(field, forces).std()),
        significant={
            name: float(significant[mask].mean())
            for name, mask in field.regions.masks(field.distance).items()
            if name != "unvisited" and mask.any()
        },
    )


def trace_influence(subject: Subject) -> Influence:
    """What each trajectory and each constant does to the parameters.

    Raises:
        InputError: it is not defined for this fit.
        FitError: a trajectory alone determines some parameter.
    """
    evidence = subject.run.evidence
    if evidence is None:
        raise InputError(NO_POSTERIOR)
    if "diffusion" in evidence.constants:
        raise InputError(
            "it is defined for fits of trajectories, not of stochastic increments"
        )
    if takes_commands(subject.run.model):
        raise InputError(
            "it is defined for fits without commands and wandering velocity"
        )
    return _influence(subject, evidence)


def _influence(subject: Subject, evidence: Evidence) -> Influence:
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


def trajectory_effects(
    subject: Subject, effects: Influence
) -> tuple[TrajectoryEffect, ...]:
    """What each trajectory does to the force and to the end of the reference."""
    changes, relative, final = _followed(subject, effects, effects.removals)
    return tuple(
        TrajectoryEffect(
            trajectory=index,
            leverage=float(effects.leverages[index]),
            cook=float(effects.distances[index]),
            force=relative[index],
            final=final[index],
            change=change,
        )
        for index, change in enumerate(changes)
    )


def constant_effects(
    subject: Subject, effects: Influence
) -> tuple[ConstantEffect, ...]:
    """What one percent of each constant does to them.

    Raises:
        InputError: the physics has no constants.
    """
    if not effects.constants:
        raise InputError("the physics has none")
    values = {
        name: float(attrgetter(CONSTANTS[name])(subject.model))
        for name in effects.constants
    }
    percents = [0.01 * values[n] * change for n, change in effects.constants.items()]
    changes, relative, final = _followed(subject, effects, np.stack(percents))
    return tuple(
        ConstantEffect(
            constant=name,
            value=values[name],
            learned=name in subject.run.choice.learn,
            force=relative[index],
            final=final[index],
            change=changes[index],
        )
        for index, name in enumerate(values)
    )


def _followed(
    subject: Subject, effects: Influence, changes: Float[np.ndarray, "change parameter"]
) -> tuple[Float[np.ndarray, "change rows columns 2"], list[float], list[float]]:
    """Changes of the force, their relative size near the data, and of the end."""
    shape = subject.field.force.shape
    forces = effects.force_changes(subject.grid, changes).reshape(-1, *shape)
    final = effects.final_changes(subject.start, subject.times, changes)[:, :2]
    near, size = subject.near, _rms(subject.field.force[subject.near])
    relative = [_rms(force[near]) / size for force in forces]
    return forces, relative, [float(np.linalg.norm(end)) for end in final]


MOST_SAMPLES = 4000
"""Samples at most over which entropy production is a mean."""


def is_thermal(run: Learned) -> bool:
    """Whether the run is a fit of thermal motion."""
    return run.evidence is not None and "diffusion" in run.evidence.constants


def produce_entropy(run: Learned) -> EntropyProduction:
    """Entropy production of thermal motion, with the current at the samples.

    Raises:
        InputError: it cannot be told of this fit.
    """
    posterior, model, data = run.posterior, run.model, run.data
    if posterior is None or not isinstance(model, OverdampedSwimmer):
        raise InputError("the run is no fit of thermal motion")
    if not isinstance(model.propulsion, ZeroForce):
        raise InputError(
            "the swimmer is driven by its propulsion, which is no steady state"
        )
    if getattr(model.environment, "is_conservative", False):
        raise InputError(
            "the model is a potential, which makes none; fit --model kernel-force"
        )
    samples = data.positions[data.observed.all(axis=-1)]
    samples = samples[:: max(len(samples) // MOST_SAMPLES, 1)]
    number = run.constants["diffusion"]
    field = np.full(samples.shape, number.value)
    if isinstance(model.mobility, KernelTensor) and run.system.thermal_energy:
        mobility = jax.vmap(model.mobility.diagonal)(jnp.asarray(samples))
        field = float(run.system.thermal_energy) * np.asarray(mobility)
    relative = number.sd / number.value
    return entropy_production(posterior, samples, field, relative)


def _rms(values: Float[np.ndarray, "... 2"]) -> float:
    return float(np.sqrt(np.mean(np.sum(values**2, axis=-1))))


def run(options: AnalyseOptions) -> CommandResult:
    """Analyse as the command line does."""
    options.settings.check()
    fitted = Learned.open(options.run)
    return keep(ANALYSE, fitted.folder, analyse(options.settings, fitted))
