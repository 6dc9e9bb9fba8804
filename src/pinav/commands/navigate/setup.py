"""The navigation problem of a run: a task, and what is known of it."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

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
from pinav.evaluation import enclosing_cube
from pinav.fitting import Posterior
from pinav.forces import RollingPropulsion
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
        task = self.task
        return float(greatest_thrust(self.model.actuator, task.limits, task.dim))


def navigation_problem(settings: NavigateSettings, run: FittedRun) -> NavigationProblem:
    """The navigation problem of a run, from its system and model alone.

    The actuator is the system's propulsion where that takes commands; a swimmer whose
    thrust cannot be steered gets one that can, of the size that the settings state.

    Raises:
        InputError: the run holds no fitted swimmer in the plane or in space, or the
            settings name places of another dimension.
    """
    model, dim = run.model, run.data.dim
    if not isinstance(model, Swimmer | OverdampedSwimmer) or dim < 2:
        raise InputError(
            f"{run.folder.path}: expected a swimmer in the plane or in space, got the "
            f"model {run.choice.name} of {', '.join(run.data.channels)}"
        )
    settings.check_dimension(dim)
    actuator, limits, lag = _actuation(settings, model, dim)
    known, truth, source = model, None, source_system(run.data.provenance)
    if source is not None and source.environment is not None:
        known, truth = source.true_swimmer, source.name
    delay = lag if settings.delay is None else settings.delay
    steered = SteeredSwimmer(known, actuator)
    return NavigationProblem(
        task=_task(settings, steered, limits, run.data, delay),
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
    )


def _actuation(
    settings: NavigateSettings, model: Swimmer | OverdampedSwimmer, dim: int
) -> tuple[RollingActuator, CommandLimits, float]:
    """What commands do, their limits, and the time from command to motion [T].

    A first-order follower of the command is taken for a further delay by its time
    constant, which is right for commands that change slowly against it.
    """
    if not takes_commands(model):
        gain = settings.thrust * jnp.eye(dim)
        return RollingActuator(gain, LinearResponse()), CommandLimits(1.0), 0.0
    propulsion = unbound(model)
    if not isinstance(propulsion, RollingPropulsion):
        raise InputError(
            "navigate: expected a propulsion by rolling, got "
            f"{type(propulsion).__name__}"
        )
    actuator = RollingActuator(propulsion.gain, propulsion.response)
    lag = float(propulsion.delay) + float(propulsion.lag)
    return actuator, CommandLimits(settings.frequency), lag


def _draws(run: FittedRun, settings: NavigateSettings) -> list[AbstractDynamics]:
    if run.posterior is None or settings.samples == 0:
        return []
    key = jax.random.fold_in(jax.random.key(settings.seed), 1)
    return run.posterior.samples(settings.samples, key=key)


def _evidence(run: FittedRun, model: AbstractDynamics) -> Evidence | None:
    """The fit's evidence where the next trajectory can be suggested.

    Not of stochastic paths, whose states are not smoothed, nor in space, where
    candidates have no elevation.
    """
    evidence = run.evidence
    if evidence is None or "diffusion" in evidence.constants or takes_commands(model):
        return None
    if run.data.dim > 2:
        return None
    return Evidence(evidence.posterior, run.noise, evidence.states)


def _goal(settings: NavigateSettings) -> ReachGoal:
    return ReachGoal(list(settings.places()[1]), settings.tolerance)


def _discs(settings: NavigateSettings) -> tuple[Disc, ...]:
    return tuple(Disc(list(disc[:-1]), disc[-1]) for disc in settings.discs())


def _task(
    settings: NavigateSettings,
    truth: SteeredSwimmer,
    limits: CommandLimits,
    data: Trajectories,
    delay: float,
) -> Task:
    start, _ = settings.places()
    rest = [0.0] * len(start) if isinstance(truth.dynamics, Swimmer) else []
    return Task(
        name="navigate",
        truth=truth,
        start=jnp.asarray([*start, *rest]),
        objective=_goal(settings),
        limits=limits,
        arena=_arena(settings, data),
        keep_out=_discs(settings),
        step=settings.step,
        time_limit=settings.time_limit,
        noise=settings.noise,
        sensor_noise=settings.sensor_noise,
        delay=delay,
    )


def _arena(settings: NavigateSettings, data: Trajectories) -> Rectangle:
    """The arena that was given, or one around data, start and goal."""
    box = settings.box()
    if box is not None:
        return Rectangle(*map(list, (box[: len(box) // 2], box[len(box) // 2 :])))
    ends = np.array(settings.places())
    margin = 0.25 * float(np.linalg.norm(ends[1] - ends[0])) + settings.tolerance
    low, high = enclosing_cube(data)
    lower = np.minimum(ends.min(axis=0) - margin, low)
    upper = np.maximum(ends.max(axis=0) + margin, high)
    return Rectangle(lower, upper)
