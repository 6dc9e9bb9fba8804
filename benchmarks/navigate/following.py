"""Paths that are followed: tasks, a controller that shoots, and its tracking errors.

References:
    Kingma and Ba, ICLR 2015, for the steps of the descent.
"""

import abc
import dataclasses
import math
from collections.abc import Sequence
from functools import partial
from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, PRNGKeyArray

from pinav.arguments import Scalar, Vector, check_positive, point
from pinav.navigation.control.controller import (
    AbstractController,
    AbstractCost,
    Controls,
    Course,
    Observation,
    Times,
    TrajectoryPrediction,
)
from pinav.navigation.control.default import compensate
from pinav.navigation.control.default import controller as arriving_controller
from pinav.navigation.planning.plan import check_places
from pinav.navigation.predictors import TimeCost, tabulate_model, within_ball
from pinav.navigation.task import catalogue
from pinav.navigation.task.steering import Command, SteeredSwimmer, direction
from pinav.navigation.task.task import AbstractObjective, Task
from pinav.navigation.trials.closed_loop import Episodes


class AbstractPath(eqx.Module):
    """A curve that is to be followed at a speed, as a point that moves along it."""

    @abc.abstractmethod
    def __call__(self, t: Scalar) -> Vector:
        """Position at which the swimmer should be at time `t` [L]."""


class LinePath(AbstractPath):
    """Along a straight line, from end to end at constant speed; then at rest."""

    start: Vector = eqx.field(converter=point("LinePath.start"))
    end: Vector = eqx.field(converter=point("LinePath.end"))
    duration: Scalar

    def __check_init__(self) -> None:
        check_positive(self, "duration")

    def __call__(self, t: Scalar) -> Vector:
        progress = jnp.clip(jnp.asarray(t) / self.duration, 0.0, 1.0)
        return self.start + progress * (self.end - self.start)


class CirclePath(AbstractPath):
    r"""$c + r (\cos\phi, \sin\phi)$, $\phi = \phi_0 + 2\pi t / T$.

    Attributes:
        center: $c$ [L].
        radius: $r$ [L], positive.
        period: $T$ [T], positive: counter-clockwise.
        phase: $\phi_0$ [rad].
    """

    center: Vector = eqx.field(converter=point("CirclePath.center", 2))
    radius: Scalar
    period: Scalar
    phase: Scalar = 0.0

    def __check_init__(self) -> None:
        check_positive(self, "radius", "period")

    def __call__(self, t: Scalar) -> Vector:
        angle = self.phase + 2 * math.pi * jnp.asarray(t) / self.period
        return self.center + self.radius * jnp.stack([jnp.cos(angle), jnp.sin(angle)])


class FigureEightPath(AbstractPath):
    r"""Gerono's lemniscate $c + r (\sin\phi, \sin\phi\cos\phi)$, $\phi = 2\pi t / T$.

    Attributes:
        center: $c$, where it crosses itself [L].
        radius: $r$, half its length [L], positive.
        period: $T$ [T], positive.
    """

    center: Vector = eqx.field(converter=point("FigureEightPath.center", 2))
    radius: Scalar
    period: Scalar

    def __check_init__(self) -> None:
        check_positive(self, "radius", "period")

    def __call__(self, t: Scalar) -> Vector:
        angle = 2 * math.pi * jnp.asarray(t) / self.period
        across = jnp.sin(angle) * jnp.cos(angle)
        return self.center + self.radius * jnp.stack([jnp.sin(angle), across])


class FollowPath(AbstractObjective):
    """Stay on a point that moves along a path, until time is up."""

    path: AbstractPath

    def target(self, t: Scalar) -> Vector:
        return self.path(t)

    def distance(self, x: Vector) -> Float[Array, ""]:
        return jnp.full((), math.inf, x.dtype)


class TrackingCost(AbstractCost):
    r"""Mean square distance from the target, $\int |x - r(t)|^2 dt$ [L² T].

    Attributes:
        objective: the target r.
        time_cost: walls; what time costs more near them is added.
        effort: weight of the squared change of the control from step to step.
    """

    objective: AbstractObjective
    time_cost: TimeCost
    effort: float = 0.0

    def __call__(self, ts: Times, ys: Course, controls: Controls) -> Float[Array, ""]:
        xs = ys[:, : self.time_cost.arena.dim]
        targets = jax.vmap(self.objective.target)(ts[1:])
        error = jnp.sum((xs[1:] - targets) ** 2, axis=1)
        running_cost = jax.vmap(self.time_cost.running_cost)(ts[1:], xs[1:]) - 1
        clearance = jax.vmap(self.time_cost.clearance)(xs[1:])
        walls = running_cost + COLLISION * (clearance < 0).astype(xs.dtype)
        change = jnp.sum(jnp.diff(controls, axis=0) ** 2)
        return jnp.sum((error + walls) * jnp.diff(ts)) + self.effort * change


COLLISION = 1e3
"""Cost of a unit of time in a wall, where a path is followed [L²]."""


_Descent = tuple[Controls, optax.OptState, Controls, Float[Array, ""]]
"""Controls, moments of Adam's steps, the best controls so far, and their cost."""


class GradientMPC(AbstractController[Controls]):
    r"""Improves a sequence of thrusts by steps along the gradient of its cost.

    The sequence takes Adam's steps whose length falls to nothing, is brought back to
    the allowed thrust after each, and the best one met is the answer. It is kept, and
    moved on by one, from step to step.

    Attributes:
        cost: of a course; differentiable almost everywhere.
        iterations: steps of descent, positive.
        rate: length of the first step, where 1 is the greatest thrust, positive.

    Raises:
        InputError: `iterations` or `rate` is not positive.
    """

    prediction: TrajectoryPrediction
    cost: AbstractCost
    iterations: int = eqx.field(static=True, default=20)
    rate: float = 0.15

    def __check_init__(self) -> None:
        check_positive(self, "iterations", "rate")

    def start(self, observation: Observation) -> Controls:
        ahead = SMALL * direction(observation.pending[-1, 1:])
        return jnp.tile(
            ahead.astype(observation.state.dtype), (self.prediction.steps, 1)
        )

    def __call__(
        self, observation: Observation, memory: Controls, *, key: PRNGKeyArray
    ) -> tuple[Command, Controls]:
        del key
        best = self._descend(observation, jnp.concatenate([memory[1:], memory[-1:]]))
        return self.prediction.command(observation, best[0]), best

    def _descend(self, observation: Observation, controls: Controls) -> Controls:
        """The best sequence met on the way down."""

        def cost(controls: Controls) -> Float[Array, ""]:
            value = self.cost(*self.prediction(observation, controls), controls)
            return jnp.where(jnp.isfinite(value), value, jnp.inf)

        method = optax.scale_by_adam()

        def descend(carry: _Descent, length: Float[Array, ""]) -> tuple[_Descent, None]:
            controls, progress, best, least = carry
            value, slope = jax.value_and_grad(cost)(controls)
            better = value < least
            best = jnp.where(better, controls, best)
            least = jnp.where(better, value, least)
            # One step of a lost rollout must not poison Adam's moments for all others.
            slope = jnp.where(jnp.isfinite(slope), slope, 0.0)
            with jax.numpy_dtype_promotion("standard"):  # as optax expects
                change, progress = method.update(slope, progress)
            controls = within_ball(controls - length * cast(Array, change))
            return (controls, progress, best, least), None

        least = jnp.asarray(jnp.inf, controls.dtype)
        begin = (controls, method.init(controls), controls, least)
        # Lengths of the steps are half a cosine, from the rate to zero.
        done = jnp.arange(self.iterations, dtype=controls.dtype) / self.iterations
        lengths = self.rate * (1 + jnp.cos(jnp.pi * done)) / 2
        (last, _, best, least), _ = jax.lax.scan(descend, begin, lengths)
        return jnp.where(cost(last) < least, last, best)


SMALL = 0.1
"""Size of the first controls: the heading of no thrust has no derivative."""


def tracking_errors(
    episodes: Episodes, task: Task, *, power: int = 1
) -> Float[np.ndarray, " episode"]:
    """Mean of the distance from the target [L], to a power, of each episode."""
    targets = np.asarray(jax.vmap(task.objective.target)(jnp.asarray(episodes.ts)))
    distances = np.linalg.norm(
        episodes.states[..., : task.dim] - targets[None], axis=-1
    )
    during = np.arange(len(episodes.ts))[None] < episodes.steps[:, None] + 1
    return np.mean(distances**power, axis=1, where=during)


def controller(
    task: Task, model: SteeredSwimmer, *, samples: Sequence[SteeredSwimmer] = ()
) -> AbstractController:
    """The controller of pinav for a place to reach; to follow a path, shooting."""
    if not isinstance(task.objective, FollowPath):
        return arriving_controller(task, model, samples=samples)
    check_places(task)
    tables = tabulate_model(task, model, samples=samples)
    ahead = TrajectoryPrediction(
        tables.predictor, tables.control_map, task.step, TRACKING_STEPS
    )
    steered = GradientMPC(ahead, TrackingCost(task.objective, tables.time_cost))
    return compensate(task, tables.predictor, steered)


TRACKING_STEPS = 10
"""Steps that the control of a path looks ahead."""


PATHS = {
    "follow-line": (partial(LinePath, [1.5, 2.0], [8.5, 8.0], 20.0), 20.0),
    "follow-circle": (partial(CirclePath, [5.0, 5.0], 2.5, 30.0), 30.0),
    "follow-eight": (partial(FigureEightPath, [5.0, 5.0], 3.0, 50.0), 50.0),
}
"""Paths in an unknown drift, with a delay of 0.2, and how long each is followed [T]."""

JUNCTION = "y-junction"
"""The task of pinav in the same drift."""

TASKS = {
    **{name: source for name, (_, source) in catalogue.TASKS.items()},
    **dict.fromkeys(PATHS, "drift-current"),
}
"""All tasks, and the scenario in which the swimmers of each are observed."""


def task(name: str) -> Task:
    """The task of that name: to follow a path, or one of pinav."""
    if name not in PATHS:
        return catalogue.task(name)
    make_path, duration = PATHS[name]
    path = make_path()
    return dataclasses.replace(
        catalogue.task(JUNCTION),
        name=name,
        start=path(0.0),
        objective=FollowPath(path),
        keep_out=(),
        time_limit=duration,
    )
