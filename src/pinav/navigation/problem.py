"""A navigation problem: a task, what is known of it, and what to record next."""

import dataclasses
from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Array, Float, Key

from pinav.dynamics import AbstractDynamics, AbstractSwimmer, takes_commands
from pinav.errors import InputError
from pinav.evaluation import enclosing_cube
from pinav.fitting import AbstractLearned, Posterior
from pinav.navigation.adaptive.flight import ORACLE
from pinav.navigation.adaptive.prior import mobilities, with_prior_of
from pinav.navigation.adaptive.steering import AdaptiveController
from pinav.navigation.adaptive.strategies import MEAN_FORCE
from pinav.navigation.control.controller import AbstractController
from pinav.navigation.control.default import controller
from pinav.navigation.design import candidates
from pinav.navigation.task.catalogue import Way
from pinav.navigation.task.steering import SteeredSwimmer, greatest_thrust, physics_only
from pinav.navigation.task.task import ReachGoal, Rectangle, Task, steered_swimmer
from pinav.navigation.trials.closed_loop import Episodes, concatenate_episodes, run_many
from pinav.scenarios import source_system

LEARNED = "learned"
"""The controller that plans with the learned model."""

PHYSICS = "physics only"
"""The controller that plans with the model without its environment."""


@dataclasses.dataclass(frozen=True)
class NavigationProblem:
    """A task and what is known of it.

    Attributes:
        task: its truth is that of the system, or the model where there is none.
        samples: draws of the posterior; none where the fit has no posterior.
        truth: name of the system whose environment is the truth, where it is known.
    """

    task: Task
    model: SteeredSwimmer
    fit: AbstractLearned
    samples: tuple[SteeredSwimmer, ...] = ()
    truth: str | None = None
    posterior: Posterior | None = None

    @classmethod
    def of(
        cls, fit: AbstractLearned, way: Way, *, samples: int = 8, seed: int = 0
    ) -> "NavigationProblem":
        """The problem of going a way through the force that a fit has learned.

        Args:
            samples: models drawn from the posterior; 0 takes the model for true.

        Raises:
            InputError: the fit is not of a swimmer in the plane or in space, or the way
                has places of another dimension.
        """
        model, dim = fit.model, fit.data.dim
        if not isinstance(model, AbstractSwimmer) or dim < 2:
            raise InputError(
                "navigate: expected a fit of a swimmer in the plane or in space, got "
                f"the model {fit.choice.name} of {', '.join(fit.data.channels)}"
            )
        if len(way.start) != dim:
            raise InputError(
                f"Way: expected places of {dim} coordinates, got {way.start}"
            )
        known, truth, source = model, None, source_system(fit.data.provenance)
        if source is not None and source.environment is not None:
            known, truth = source.true_swimmer, source.name
        corners = np.array(enclosing_cube(fit.data))
        task, draws = way.task(model, known, "way", corners), []
        if fit.posterior is not None and samples:
            key = jax.random.fold_in(jax.random.key(seed), 1)
            # Far from the data the force may be as large as the thrust: a plan
            # that counts it as risk would reach no goal there.
            known = dataclasses.replace(fit.posterior, visited=None)
            draws = known.samples(samples, key=key)
        return cls(
            task=task,
            model=steered_swimmer(task, model),
            samples=tuple(
                steered_swimmer(task, draw)
                for draw in draws
                if isinstance(draw, AbstractSwimmer)
            ),
            truth=truth,
            fit=fit,
            posterior=_posterior(fit, model),
        )

    @property
    def goal(self) -> ReachGoal:
        """The middle of the goal, and its radius."""
        assert isinstance(self.task.objective, ReachGoal)
        return self.task.objective

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

    @property
    def models(self) -> list[str]:
        """Models to plan with; the truth is left out where it is not known."""
        return [LEARNED, PHYSICS, *([ORACLE] if self.truth is not None else [])]

    def controller_with(self, name: str) -> AbstractController:
        """The controller that takes a model for true."""
        if name == LEARNED:
            return controller(self.task, self.model, samples=self.samples)
        model = physics_only(self.model) if name == PHYSICS else self.task.truth
        return controller(self.task, model)

    def attempt(
        self,
        steering: AbstractController,
        keys: Key[Array, " episode"],
        numbers: Sequence[int] | None = None,
    ) -> Episodes:
        """Closed loops of a controller, one for each key, over the possible truths.

        Args:
            numbers: which of them are done, ascending; all unless given.
        """
        truths = self.truths[: len(keys)]
        chosen = np.arange(len(keys)) if numbers is None else np.asarray(numbers)
        parts, order = [], []
        for index, truth in enumerate(truths):
            some = np.flatnonzero(chosen % len(truths) == index)
            if len(some):
                picked = keys[chosen[some]]
                parts.append(run_many(self.task, steering, picked, truth=truth))
                order.append(some)
        return concatenate_episodes(parts).select(np.argsort(np.concatenate(order)))


def episode_keys(seed: int, count: int) -> Key[Array, " {count}"]:
    """Random keys of so many closed loops."""
    return jax.random.split(jax.random.key(seed), count)


def _posterior(fit: AbstractLearned, model: AbstractDynamics) -> Posterior | None:
    """The fit's posterior where the next trajectory can be suggested.

    Not of stochastic paths, whose states are not smoothed, nor in space, where
    candidates have no elevation.
    """
    if fit.evidence is None or "diffusion" in fit.evidence.constants:
        return None
    return None if takes_commands(model) or fit.data.dim > 2 else fit.posterior


SAMPLES = 120
"""Samples of a suggested trajectory at most."""


def suggest_trajectory(
    problem: NavigationProblem, route: Float[np.ndarray, "time dim"], *, seed: int
) -> candidates.Suggestion | None:
    """The trajectory that would tell most about the force along a route.

    It is released near the start and observed as the data were, without white noise.
    The fitted force is believed as far as its posterior knows it, and elsewhere forces
    may be as strong as a belief that begins without data takes them to be.

    Returns:
        The trajectory; none where the fit has no evidence that one could improve, or
        every candidate leaves the arena.
    """
    task, fit = problem.task, problem.fit
    if problem.posterior is None:
        return None
    data, start = fit.data, np.asarray(task.start[:2])
    spans = [piece.times[-1] - piece.times[0] for piece in data]
    interval = float(np.median(np.concatenate([np.diff(p.times) for p in data])))
    recorded = dataclasses.replace(
        task,
        truth=problem.model,
        step=interval,
        noise=0.0,
        sensor_noise=float(fit.noise),
    )
    adaptive = with_prior_of(
        AdaptiveController.of(recorded, MEAN_FORCE),
        problem.model.dynamics,
        problem.posterior,
        data.seen_positions,
    )
    assert adaptive.known is not None
    fitted = dataclasses.replace(adaptive.known, filters=(adaptive.known.best,))
    experiment = candidates.Experiment(
        recorded,
        Rectangle(start - problem.goal.tolerance, start + problem.goal.tolerance),
        min(task.time_limit, float(np.median(spans)), SAMPLES * interval),
    )
    key = jax.random.fold_in(jax.random.key(seed), 2)
    found = candidates.suggest_next(
        candidates.Stage(adaptive, experiment, fitted, route), key=key
    )
    if found is None or task.inertial:
        return found
    # What a belief knows without inertia are velocities; a fit knows forces.
    traces = np.trace(mobilities(adaptive.physics, route), axis1=1, axis2=2)
    return found.scale(2 / float(np.mean(traces)))
