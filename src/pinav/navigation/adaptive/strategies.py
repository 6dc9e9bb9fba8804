"""Plans under uncertainty: the price of a unit of time where the force is unknown."""

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.navigation.belief.belief import Belief
from pinav.navigation.model.tables import FieldTable, Grid
from pinav.navigation.model.tabulated import TabulatedModel

DRAWS = 12
"""Draws of the force from which its standard deviation on a map is taken."""

WORTH = 4.0
"""Bonus of a unit of time where as much is unknown as the thrust gives, over the length
scale in parts of the grid."""

HOPE = 0.25
"""Standard deviations by which a hopeful plan takes the mean force to be weaker."""

MOST = 0.9
"""The greatest bonus, so that time always costs something."""


class AbstractStrategy(eqx.Module):
    """Turns a belief into tables to plan on."""

    @abc.abstractmethod
    def tables(
        self, belief: Belief, physics: TabulatedModel, thrust: float
    ) -> TabulatedModel:
        """Tables of the mean force, with a price where it is not known."""


class MeanForce(AbstractStrategy):
    """The mean is taken for true: where nothing was seen there is no force."""

    def tables(
        self, belief: Belief, physics: TabulatedModel, thrust: float
    ) -> TabulatedModel:
        return with_force(physics, mean_on(belief, physics.table.grid))


class ExplorationBonus(AbstractStrategy):
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
        grid = physics.table.grid
        force, spread = mean_and_spread(belief, grid)
        size = np.maximum(np.linalg.norm(force, axis=-1), 1e-12)
        factor = np.maximum(1 - (self.hope + self.boldness) * spread / size, 0.0)
        bonus = 1 - (1 - bonus_of(belief, grid, self.worth)) ** (1 + self.boldness)
        model = with_force(physics, force * factor[..., None])
        return with_spread(model, spread / thrust, -bonus)


def bonus_of(belief: Belief, grid: Grid, worth: float) -> float:
    """The bonus for what is unknown: by the length scale, in parts of a grid."""
    sides = [float(axis[-1] - axis[0]) for axis in axes_of(grid)]
    return min(worth * belief.length_scale / max(sides), MOST)


def axes_of(grid: Grid) -> tuple[Float[np.ndarray, " x"], Float[np.ndarray, " y"]]:
    """Coordinates of a grid along each axis [L]."""
    lower, spacing = np.asarray(grid.lower), np.asarray(grid.spacing)
    x, y = (lower[k] + spacing[k] * np.arange(grid.shape[k]) for k in range(2))
    return x, y


def mean_on(belief: Belief, grid: Grid) -> Float[np.ndarray, "x y 2"]:
    """Mean force on a grid."""
    return belief.force_on(axes_of(grid))


def mean_and_spread(
    belief: Belief, grid: Grid
) -> tuple[Float[np.ndarray, "x y 2"], Float[np.ndarray, "x y"]]:
    """Mean force on a grid, and standard deviation of a component, from draws."""
    draws = belief.samples(axes_of(grid), DRAWS, seed=belief.count)
    variance = np.mean(np.var(draws, axis=0, ddof=1), axis=-1)
    return mean_on(belief, grid), np.sqrt(variance)


def with_force(
    physics: TabulatedModel, force: Float[np.ndarray, "x y 2"]
) -> TabulatedModel:
    """Tables with a force, or a velocity, added to what is known."""
    values = np.array(physics.table.values)
    values[..., :2] += force
    table = FieldTable(physics.table.grid, jnp.asarray(values))
    return eqx.tree_at(
        lambda model: (model.table, model.predictor.table), physics, (table, table)
    )


def with_spread(
    model: TabulatedModel, ratio: Float[np.ndarray, "x y"], price: float
) -> TabulatedModel:
    """Tables in which time has a price where the force is not known.

    Args:
        model: the tables.
        ratio: s / u on their grid.
        price: of a unit of its square.
    """
    spread = FieldTable(model.table.grid, jnp.asarray(ratio)[None, ..., None])
    return eqx.tree_at(
        lambda m: (m.time_cost.spread, m.time_cost.risk_aversion),
        model,
        (spread, jnp.asarray(price)),
    )
