"""A force as a table over the plane and time, for one that cannot be printed."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from pinav.arguments import Scalar, Vector
from pinav.forces import AbstractForce, forces_at
from pinav.navigation.tables import FieldTable, Grid

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
    """A force that is read from a table, cubic in space and linear in time [F].

    Attributes:
        first: the time at which the table begins [T].
    """

    table: FieldTable
    first: Scalar

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return self.table(t - self.first, x)


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
    spacing = jnp.asarray((upper - lower) / (SIDE - 1))
    grid = Grid(jnp.asarray(lower), spacing, (SIDE, SIDE))
    values = [forces_at(force, np.full(grid.shape, t), grid.points) for t in moments]
    interval = (last - first) / max(len(moments) - 1, 1) or 1.0
    table = TabulatedForce(FieldTable(grid, jnp.stack(values), interval), first)
    missed = np.abs(np.asarray(forces_at(table, times, points)) - exact).max()
    return table, float(missed / max(np.abs(exact).max(), np.finfo(float).tiny))
