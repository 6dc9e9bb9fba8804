"""Planes of a box at which a run keeps the temperature over time."""

from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

AXES = "xyz"

MOMENTS = 61
"""Times at most at which the temperature of a section is kept."""

PREFIX = "section/"
"""Of the names of what is kept; the axis that the plane is normal to follows."""


class Section(NamedTuple):
    """A plane of cells, or all of a field that is a plane itself.

    Attributes:
        axis: the plane is normal to it.
        place: index of the cells along it; none where the field has no third axis.
    """

    axis: int
    place: int | None

    @property
    def name(self) -> str:
        """Under which a run keeps the section."""
        return PREFIX + AXES[self.axis]

    def of(self, field: Float[Array, "..."]) -> Float[Array, "row column"]:
        """The section of a field."""
        if self.place is None:
            return field
        return jnp.take(field, self.place, axis=self.axis)


def sections_of(target: Float[np.ndarray, "..."]) -> tuple[Section, ...]:
    """The plane itself, or the three planes through the middle of a target in a box.

    A radius has none.

    Args:
        target: share of the target in each cell.
    """
    if target.ndim == 1:
        return ()
    if target.ndim == 2:
        return (Section(2, None),)
    places = np.indices(target.shape).reshape(3, -1) @ target.reshape(-1)
    middle = np.round(places / target.sum()).astype(int).tolist()
    return tuple(Section(axis, middle[axis]) for axis in (2, 1, 0))


def section_arrays(
    target: Float[np.ndarray, "..."],
    times: Float[np.ndarray, " time"],
    observed: Mapping[str, Float[Array | np.ndarray, "..."]],
) -> dict[str, np.ndarray]:
    """What a run keeps of its sections, at `MOMENTS` times of all at most.

    Args:
        target: share of the target in each cell.
        times: of the temperatures [s].
        observed: temperatures of the sections at all times [°C], among others.
    """
    sections = sections_of(target)
    if not sections:
        return {}
    count = len(times)
    kept = np.unique(np.linspace(0, count - 1, min(MOMENTS, count)).round().astype(int))
    indices = [-1 if section.place is None else section.place for section in sections]
    return {
        f"{PREFIX}times": times[kept],
        f"{PREFIX}indices": np.array(indices),
        **{s.name: np.asarray(observed[s.name], "f4")[kept] for s in sections},
    }
