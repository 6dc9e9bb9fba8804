"""The navigation problem of a run: a task, and what is known of it."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.actuation import LinearResponse
from pinav.commands.fitted_run import FittedRun
from pinav.commands.navigate.settings import NavigateSettings
from pinav.dynamics import (
    AbstractDynamics,
    OverdampedSwimmer,
    Swimmer,
    takes_commands,
    unbound,
)
from pinav.errors import InputError
from pinav.evaluation import square
from pinav.fitting import Posterior
from pinav.forces import RollingPropulsion, ZeroForce
from pinav.navigation import (
    CommandLimits,
    Disc,
    ReachGoal,
    Rectangle,
    RollingActuator,
    SteeredSwimmer,
    Task,
    physics_only,
)
from pinav.navigation.task.steering import greatest_thrust
from pinav.scenarios import source_system
from pinav.systems import System
from pinav.trajectories import Trajectories


@dataclasses.dataclass(frozen=True)
class Evidence:
    """A fit of trajectories with a posterior, which further ones can improve.

    Attributes:
        posterior: of the model.
        noise: standard deviation of what was observed.
        states: smoothed states of the data.
    """

    posterior: Posterior
    noise: float
    states: np.ndarray


@dataclasses.dataclass(frozen=True)
class NavigationProblem:
    """A task and what is known of it.

    Attributes:
        task: its truth is that of the system, or the model where there is none.
        model: the fitted swimmer.
        samples: of the posterior; none where the run has no posterior.
        truth: the name of the system whose environment is the truth, where known.
        evidence: of the fit, where further trajectories can be suggested.
        goal: the middle of the goal, and its radius.
        discs: that must not be entered.
        data: what was fitted.
        order: of the dynamics in time.
        force: unit of a force, where the mobility makes a velocity of it.
    """

    task: Task
    model: SteeredSwimmer
    samples: tuple[SteeredSwimmer, ...]
    truth: str | None
    evidence: Evidence | None
    goal: ReachGoal
    discs: tuple[Disc, ...]
    data: Trajectories
    order: int
    force: str

    @property
    def physics(self) -> SteeredSwimmer:
        """The fitted swimmer without its environment."""
        return physics_only(self.model)

    @property
    def truths(self) -> tuple[SteeredSwimmer, ...]:
        """Swimmers in which controllers are tried."""
        if self.truth is None and self.samples:
            return self.samples
        return (self.task.truth,)

    @property
    def thrust(self) -> float:
        """The greatest thrust that can be commanded."""
        return float(greatest_thrust(self.model.actuator, self.task.limits))


def navigation_problem(settings: NavigateSettings, run: FittedRun) -> NavigationProblem:
    """The navigation problem of a run, from its system and model alone.

    The actuator is the system's propulsion where that takes commands; a swimmer whose
    thrust cannot be steered gets one that can, of the size that the settings state.

    Raises:
        InputError: the run holds no fitted swimmer in the plane.
    """
    model = run.model
    if not isinstance(model, Swimmer | OverdampedSwimmer) or run.data.dim != 2:
        raise InputError(
            f"{run.folder.path}: expected a swimmer in the plane, got the model "
            f"{run.choice.name} of {', '.join(run.data.channels)}"
        )
    actuator, limits, lag = _actuation(settings, model)
    known, truth, source = model, None, source_system(run.data.provenance)
    if source is not None and source.environment is not None:
        known, truth = source.true_swimmer, source.name
    delay = lag if settings.delay is None else settings.delay
    steered = SteeredSwimmer(known, actuator)
    corners = np.reshape(square(run.data), (2, 2)).T
    return NavigationProblem(
        task=_task(settings, steered, limits, _arena(settings, corners), delay),
        model=SteeredSwimmer(model, actuator),
        samples=tuple(
            SteeredSwimmer(draw, actuator)
            for draw in _draws(run, settings)
            if isinstance(draw, Swimmer | OverdampedSwimmer)
        ),
        truth=truth,
        evidence=_evidence(run, model),
        goal=_goal(settings),
        discs=_discs(settings),
        data=run.data,
        order=run.system.order,
        force=run.system.base_units.force,
    )


def system_task(settings: NavigateSettings, system: System) -> Task:
    """The task of going through the true environment of a system, without data.

    The actuator is that of `navigation_problem`. The arena surrounds start and goal
    unless the settings state it.

    Raises:
        InputError: the system is not planar or states no true environment.
    """
    _check_planar(system)
    return _task_of(settings, system, system.true_swimmer, np.zeros((0, 2)))


def known_task(settings: NavigateSettings, system: System, data: Trajectories) -> Task:
    """The same in a system of which nothing more than data are known.

    The truth of the task is the known physics; the arena surrounds the data, too.

    Raises:
        InputError: the system or the data are not planar.
    """
    _check_planar(system)
    if data.dim != 2:
        raise InputError(
            f"--data: expected positions in the plane, got {', '.join(data.channels)}"
        )
    corners = np.reshape(square(data), (2, 2)).T
    swimmer = system.swimmer.with_environment(ZeroForce())
    return _task_of(settings, system, swimmer, corners)


def _check_planar(system: System) -> None:
    if system.dim != 2:
        raise InputError(
            f"system: expected a swimmer in the plane, got {system.name!r}, which has "
            f"{system.dim} dimensions; state a system with dimension = 2"
        )


def _task_of(
    settings: NavigateSettings,
    system: System,
    swimmer: Swimmer | OverdampedSwimmer,
    places: Float[np.ndarray, "place 2"],
) -> Task:
    actuator, limits, lag = _actuation(settings, swimmer)
    return _task(
        settings,
        SteeredSwimmer(swimmer, actuator),
        limits,
        _arena(settings, places),
        lag if settings.delay is None else settings.delay,
        name=system.name,
    )


def _actuation(
    settings: NavigateSettings, model: Swimmer | OverdampedSwimmer
) -> tuple[RollingActuator, CommandLimits, float]:
    """What commands do, their limits, and the time from command to motion [T].

    A first-order follower of the command is taken for a further delay by its time
    constant, which is right for commands that change slowly against it.
    """
    propulsion = unbound(model) if takes_commands(model) else model.propulsion
    if not isinstance(propulsion, RollingPropulsion):
        gain = settings.thrust * jnp.eye(2)
        return RollingActuator(gain, LinearResponse()), CommandLimits(1.0), 0.0
    actuator = RollingActuator(propulsion.gain, propulsion.response)
    lag = float(propulsion.delay) + float(propulsion.lag)
    return actuator, CommandLimits(settings.frequency), lag


def _draws(run: FittedRun, settings: NavigateSettings) -> list[AbstractDynamics]:
    if run.posterior is None or settings.samples == 0:
        return []
    key = jax.random.fold_in(jax.random.key(settings.seed), 1)
    return run.posterior.samples(settings.samples, key=key)


def _evidence(run: FittedRun, model: AbstractDynamics) -> Evidence | None:
    """The fit's evidence; none for stochastic paths, whose states are not smoothed."""
    evidence = run.evidence
    if evidence is None or "diffusion" in evidence.constants or takes_commands(model):
        return None
    return Evidence(evidence.posterior, run.noise, evidence.states)


def _goal(settings: NavigateSettings) -> ReachGoal:
    return ReachGoal(list(settings.places()[1]), settings.tolerance)


def _discs(settings: NavigateSettings) -> tuple[Disc, ...]:
    return tuple(Disc(list(disc[:2]), disc[2]) for disc in settings.discs())


def _task(
    settings: NavigateSettings,
    truth: SteeredSwimmer,
    limits: CommandLimits,
    arena: Rectangle,
    delay: float,
    name: str = "navigate",
) -> Task:
    start, _ = settings.places()
    rest = (0.0, 0.0) if isinstance(truth.dynamics, Swimmer) else ()
    return Task(
        name=name,
        truth=truth,
        start=jnp.asarray([*start, *rest]),
        objective=_goal(settings),
        limits=limits,
        arena=arena,
        keep_out=_discs(settings),
        step=settings.step,
        time_limit=settings.time_limit,
        noise=settings.noise,
        sensor_noise=settings.sensor_noise,
        delay=delay,
    )


def _arena(
    settings: NavigateSettings, places: Float[np.ndarray, "place 2"]
) -> Rectangle:
    """The arena that was given, or one around start, goal and further places [L]."""
    box = settings.box()
    if box is not None:
        return Rectangle(list(box[:2]), list(box[2:]))
    ends = np.array(settings.places())
    margin = 0.25 * float(np.linalg.norm(ends[1] - ends[0])) + settings.tolerance
    inside = np.concatenate([ends - margin, ends + margin, places])
    return Rectangle(inside.min(axis=0), inside.max(axis=0))
