"""The known motion of a belief, its plans under uncertainty, and progress."""

import dataclasses
import operator
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.navigation.belief.belief import Belief, Frame
from pinav.navigation.belief.kernel_filter import KernelFilter
from pinav.navigation.belief.motion import (
    AbstractMotion,
    InertialMotion,
    OverdampedMotion,
    Vector,
)
from pinav.navigation.predictors import InertialTable, TabulatedModel
from pinav.navigation.tables import FieldTable, Grid
from pinav.navigation.task.task import Task

DRAWS = 12
"""Draws of the force from which its standard deviation on a map is taken."""

WORTH = 4.0
"""Bonus of a unit of time where as much is unknown as the thrust gives, over the length
scale in parts of the grid."""

HOPE = 0.25
"""Standard deviations by which a hopeful plan takes the mean force to be weaker."""

MOST = 0.9
"""The greatest bonus, so that time always costs something."""


class ExplorationBonus(eqx.Module):
    r"""A hopeful mean, and a bonus for the information that a visit would give.

    The mean force is weaker by $c = \kappa + b$ standard deviations, down to nothing,
    $F \max(0, 1 - c\, s / |F|)$: what a flight against it shows to be true is
    avoided then, but a detour never shows that it was not needed. What is known well
    stays as it is.

    Time costs $1 - p\,(s/u)^2$ with $p = 1 - (1 - w\,\ell/L)^{1+b}$. A flight through
    the unknown lowers its variance nearly to zero, so that the variance is the
    information to be had there. It tells of surroundings as wide as the length scale
    $\ell$ of the force: on a grid of the longer side L, more of the way to the goal
    where the force is smooth than where it changes from place to place.

    With neither hope nor bonus, `MEAN_FORCE`, the mean is taken for true: where nothing
    was seen there is no force.

    Attributes:
        worth: w.
        hope: $\kappa$.
        boldness: b, how often the swimmer was stalled.
    """

    worth: float = WORTH
    hope: float = HOPE
    boldness: int = 0

    def tables(
        self, belief: Belief, physics: TabulatedModel, thrust: float
    ) -> TabulatedModel:
        """Tables of the mean force, with a price where it is not known."""
        grid, axes = physics.table.grid, axes_of(physics.table.grid)
        if self.worth == self.hope == self.boldness == 0:
            return with_force(physics, belief.force_on(axes))
        force, spread = mean_and_spread(belief, grid)
        size = np.maximum(np.linalg.norm(force, axis=-1), 1e-12)
        factor = np.maximum(1 - (self.hope + self.boldness) * spread / size, 0.0)
        longer = max(float(axis[-1] - axis[0]) for axis in axes)
        usual_bonus = min(self.worth * belief.length_scale / longer, MOST)
        bonus = 1 - (1 - usual_bonus) ** (1 + self.boldness)
        ratio = FieldTable(grid, jnp.asarray(spread / thrust)[None, ..., None])
        return eqx.tree_at(
            lambda model: (model.time_cost.spread, model.time_cost.risk_aversion),
            with_force(physics, force * factor[..., None]),
            (ratio, jnp.asarray(-bonus)),
        )


MEAN_FORCE = ExplorationBonus(worth=0.0, hope=0.0)
"""The mean is taken for true."""


def axes_of(grid: Grid) -> tuple[Float[np.ndarray, " x"], Float[np.ndarray, " y"]]:
    """Coordinates of a grid along each axis [L]."""
    lower, spacing = np.asarray(grid.lower), np.asarray(grid.spacing)
    x, y = (lower[k] + spacing[k] * np.arange(grid.shape[k]) for k in range(2))
    return x, y


def mean_and_spread(
    belief: Belief, grid: Grid
) -> tuple[Float[np.ndarray, "x y 2"], Float[np.ndarray, "x y"]]:
    """Mean force on a grid, and standard deviation of a component, from draws."""
    axes = axes_of(grid)
    draws = belief.samples(axes, DRAWS, seed=belief.count)
    variance = np.mean(np.var(draws, axis=0, ddof=1), axis=-1)
    return belief.force_on(axes), np.sqrt(variance)


def with_force(
    physics: TabulatedModel, force: Float[np.ndarray, "x y 2"]
) -> TabulatedModel:
    """Tables with a force, or a velocity, added to what is known."""
    values = np.array(physics.table.values)
    values[..., :2] += force
    table = FieldTable(physics.table.grid, jnp.asarray(values))
    return eqx.tree_at(lambda model: model.predictor.table, physics, table)


def motion_of(task: Task, physics: TabulatedModel) -> AbstractMotion:
    """The motion of a belief: its drag is the mean over arena and directions."""
    if isinstance(physics.predictor, InertialTable):
        drag = np.asarray(physics.table.values[0, ..., 2:]).reshape(-1, 2, 2)
        return InertialMotion(float(np.mean(np.trace(drag.T))) / 2, task.noise)
    return OverdampedMotion(task.noise)


def with_known(frame: Frame, belief: Belief, physics: TabulatedModel) -> Frame:
    """A frame whose thrust is all that is known of the rate since the last one."""
    elapsed = frame.time - belief.time
    rate = known_rate(belief.best, frame.thrust, elapsed, physics)
    return dataclasses.replace(frame, thrust=rate)


def known_rate(
    before: KernelFilter, thrust: Vector, elapsed: float, physics: TabulatedModel
) -> Vector:
    r"""Known rate of the velocity, or of the position without inertia.

    A table of the known physics holds the rate at rest a and a matrix D or M at each
    place. With the thrust u and the drag $\gamma$ of the motion, the known rate is
    $a + u - (D - \gamma)\,v$ with inertia and $a + M u$ without, at the middle of the
    way as it was believed.
    """
    motion, state = before.motion, before.state
    dim = len(thrust)
    inertial = isinstance(motion, InertialMotion)
    velocity = state[dim:] if inertial else np.zeros(dim)
    middle = state[:dim] + velocity * elapsed / 2
    values = np.asarray(_call(physics.table, 0.0, jnp.asarray(middle)), float)
    rate, matrix = values[:dim], values[dim:].reshape(dim, dim)
    if inertial:
        return rate + thrust - (matrix - motion.damping * np.eye(dim)) @ velocity
    return rate + matrix @ thrust


_call = eqx.filter_jit(operator.call)


CLOCK = 1e-6
"""Times that are nearer than this are one [T]."""


@dataclasses.dataclass(frozen=True, eq=False)
class Progress:
    """Places where a swimmer was, and the time since it came to a new one.

    A place is new if it is far from all places where the swimmer was. Who hovers comes
    nowhere new, and neither does who goes to and fro, however fast. Who goes back out
    of a dead end does not either, but as it believes the goal comes nearer.

    Attributes:
        length: distance from old places that makes a place new [L].
        since: when it came to the last of the places, nearer, or became bolder [T].
        patience: stalled is who came nowhere new in so long [T], and not nearer by half
            of it.
        boldness: how often the patience ended so far.
        stalled: whether it has ended since the swimmer came to a new place.
    """

    length: float
    places: Float[np.ndarray, "place 2"]
    since: float
    state: Float[np.ndarray, " state"]
    patience: float
    boldness: int = 0
    stalled: bool = False

    def after(
        self,
        time: float,
        state: Float[np.ndarray, " state"],
        time_to_go: Callable[[Float[np.ndarray, " state"]], float],
    ) -> "Progress":
        """The progress a frame later.

        Args:
            state: state of the swimmer, its position first.
            time_to_go: from a state, as the last plan has it [T]. Old and new state are
                compared by one plan, because what is learned changes all of them.
        """
        place = state[None, :2]
        new = np.min(np.linalg.norm(self.places - place, axis=1)) > self.length
        if not new and time - self.since < self.patience - CLOCK:
            return self
        places = np.concatenate([self.places, place]) if new else self.places
        gained = time_to_go(self.state) - time_to_go(state)
        stalled = not new and bool(gained < self.patience / 2)
        boldness = self.boldness + stalled
        return Progress(
            self.length, places, time, state, self.patience, boldness, stalled
        )
