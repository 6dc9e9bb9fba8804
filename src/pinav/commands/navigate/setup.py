"""The navigation problem of a run: a task, and what is known of it."""

import dataclasses

import jax
import numpy as np

from pinav.commands.navigate import NAVIGATE
from pinav.commands.navigate.settings import NavigateSettings
from pinav.commands.steering import task_of
from pinav.dynamics import (
    AbstractDynamics,
    OverdampedSwimmer,
    Swimmer,
    takes_commands,
)
from pinav.errors import InputError
from pinav.evaluation import enclosing_cube
from pinav.fitting import Posterior
from pinav.learning.learned import Learned
from pinav.navigation import (
    Disc,
    ReachGoal,
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
        data: what was fitted.
        order: of the dynamics in time.
        force: unit of a force, where the mobility makes a velocity of it.
    """

    task: Task
    model: SteeredSwimmer
    samples: tuple[SteeredSwimmer, ...]
    truth: str | None
    evidence: Evidence | None
    data: Trajectories
    order: int
    force: str

    @property
    def goal(self) -> ReachGoal:
        """The middle of the goal, and its radius."""
        assert isinstance(self.task.objective, ReachGoal)
        return self.task.objective

    @property
    def discs(self) -> tuple[Disc, ...]:
        """What must not be entered."""
        return tuple(zone for zone in self.task.keep_out if isinstance(zone, Disc))

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


def navigation_problem(settings: NavigateSettings, run: Learned) -> NavigationProblem:
    """The navigation problem of a run, from its system and model alone.

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
    known, truth, source = model, None, source_system(run.data.provenance)
    if source is not None and source.environment is not None:
        known, truth = source.true_swimmer, source.name
    corners = np.array(enclosing_cube(run.data))
    task = task_of(settings, model, known, corners, NAVIGATE.name)
    actuator = task.truth.actuator
    return NavigationProblem(
        task=dataclasses.replace(task, sensor_noise=settings.sensor_noise),
        model=SteeredSwimmer(model, actuator),
        samples=tuple(
            SteeredSwimmer(draw, actuator)
            for draw in _draws(run, settings)
            if isinstance(draw, Swimmer | OverdampedSwimmer)
        ),
        truth=truth,
        evidence=_evidence(run, model),
        data=run.data,
        order=run.system.order,
        force=run.system.base_units.force,
    )


def _draws(run: Learned, settings: NavigateSettings) -> list[AbstractDynamics]:
    if run.posterior is None or settings.samples == 0:
        return []
    key = jax.random.fold_in(jax.random.key(settings.seed), 1)
    return run.posterior.samples(settings.samples, key=key)


def _evidence(run: Learned, model: AbstractDynamics) -> Evidence | None:
    """The fit's evidence where the next trajectory can be suggested.

    Not of stochastic paths, whose states are not smoothed, nor in space, where
    candidates have no elevation.
    """
    evidence, posterior = run.evidence, run.posterior
    if evidence is None or posterior is None:
        return None
    if "diffusion" in evidence.constants or takes_commands(model):
        return None
    if run.data.dim > 2:
        return None
    return Evidence(posterior, run.noise, evidence.states)
