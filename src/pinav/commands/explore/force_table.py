"""A force as a table over the plane and time, for one that cannot be printed."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from pinav.arguments import Scalar, Vector
from pinav.forces import AbstractForce, forces_at

SIDE = 97
"""Places along each side; half as many err eight times as much."""

MOMENTS = 9
"""Moments of a force that changes in time."""

MARGIN = 0.1
"""Share of the box by which a table goes beyond each side of it."""

CHECKED = 400
"""Random places at which a table is compared with its force."""


class TableBox(NamedTuple):
    """Where and when a force is tabulated.

    Attributes:
        lower: least x and y [L].
        upper: greatest x and y [L].
        times: first and last time [T].
    """

    lower: tuple[float, float]
    upper: tuple[float, float]
    times: tuple[float, float]


class TabulatedForce(AbstractForce):
    """A force that is read from a table: cubic in space, linear in time.

    Beyond the table its last values hold. The error of Keys' cubic convolution falls
    with the third power of the spacing.

    Attributes:
        values: the force at each moment and place [F].
        lower: the first place [L].
        spacing: between places [L].
        first: the first moment [T].
        step: between moments [T].

    References:
        Keys, IEEE Trans. Acoust. Speech Signal Process. 29, 1153 (1981).
    """

    values: Float[Array, "moment x y 2"]
    lower: Float[Array, "2"]
    spacing: Float[Array, "2"]
    first: float
    step: float

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        moments, *sides = self.values.shape[:3]
        place = jnp.clip((x - self.lower) / self.spacing, 1.0, jnp.array(sides) - 2.0)
        cell = jnp.clip(jnp.floor(place), 1, jnp.array(sides) - 3)
        along, across = (cubic_weights(share) for share in place - cell)
        moment = jnp.clip((t - self.first) / self.step, 0.0, max(moments - 1, 0))
        before = jnp.clip(jnp.floor(moment), 0, max(moments - 2, 0))
        i, j = (cell - 1).astype(int)
        depth = min(moments, 2)
        start, window = (before.astype(int), i, j, 0), (depth, 4, 4, 2)
        near = lax.dynamic_slice(self.values, start, window)
        forces = jnp.einsum("a,b,tabd->td", along, across, near)
        return forces[0] + (moment - before) * (forces[-1] - forces[0])


def cubic_weights(share: Scalar) -> Float[Array, "4"]:
    """Weights of four neighbours at a share of the way from the second to the third."""
    s = jnp.asarray(share)
    second = 1 + s**2 * (1.5 * s - 2.5)
    third = s * (0.5 + s * (2 - 1.5 * s))
    return jnp.stack([-0.5 * s * (1 - s) ** 2, second, third, -0.5 * s**2 * (1 - s)])


def tabulate(force: AbstractForce, box: TableBox) -> tuple[TabulatedForce, float]:
    """A table of a force on a swimmer at rest, and its error.

    Args:
        force: of an environment in the plane.
        box: where it is tabulated.

    Returns:
        The table, and the largest error that was found at random places, as a share of
        the largest force there.
    """
    lower, upper = np.array(box.lower), np.array(box.upper)
    margin = MARGIN * (upper - lower)
    lower, upper = lower - margin, upper + margin
    first, last = box.times
    generator = np.random.default_rng(0)
    points = generator.uniform(lower + margin, upper - margin, (CHECKED, 2))
    times = generator.uniform(first, last, CHECKED)
    exact = np.asarray(forces_at(force, times, points))
    is_static = np.array_equal(exact, forces_at(force, np.full(CHECKED, first), points))
    moments = np.linspace(first, last, 1 if is_static else MOMENTS)
    axes = np.linspace(lower, upper, SIDE).T
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    values = [forces_at(force, np.full(places.shape[:2], t), places) for t in moments]
    table = TabulatedForce(
        jnp.stack(values),
        jnp.asarray(lower),
        jnp.asarray((upper - lower) / (SIDE - 1)),
        first,
        (last - first) / max(len(moments) - 1, 1) or 1.0,
    )
    missed = np.abs(np.asarray(forces_at(table, times, points)) - exact).max()
    return table, float(missed / max(np.abs(exact).max(), np.finfo(float).tiny))
