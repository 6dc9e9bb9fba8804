"""Maps of a task: its places, and forces on a grid over its arena."""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pinav.evaluation import FieldMap
from pinav.navigation.task.task import Disc, ReachGoal, Task

Places = Float[np.ndarray, "place 2"]
"""Positions in the plane [L]."""


@dataclasses.dataclass(frozen=True, eq=False)
class Course:
    """The places of a task of reaching a goal.

    Attributes:
        arena: lower and upper corner [L].
        discs: centre and radius of each disc, or ball, that must not be entered [L].
    """

    arena: Float[np.ndarray, "2 dim"]
    start: Float[np.ndarray, " dim"]
    goal: Float[np.ndarray, " dim"]
    tolerance: float
    discs: Float[np.ndarray, "disc number"]

    @classmethod
    def of(cls, task: Task) -> "Course":
        """The places of a task whose objective is a place to reach."""
        goal, dim = task.objective, task.dim
        assert isinstance(goal, ReachGoal)
        discs = [[*z.center, z.radius] for z in task.keep_out if isinstance(z, Disc)]
        return cls(
            arena=np.array([task.arena.lower, task.arena.upper], float),
            start=np.asarray(task.start[:dim], float),
            goal=np.asarray(goal.goal, float),
            tolerance=float(goal.tolerance),
            discs=np.array(discs, float).reshape(-1, dim + 1),
        )


class ArenaGrid(NamedTuple):
    """Equally spaced points of an arena."""

    x: Float[np.ndarray, " x"]
    y: Float[np.ndarray, " y"]

    @classmethod
    def over(cls, course: Course, points: int) -> "ArenaGrid":
        """The grid with so many points along each side of the arena."""
        lower, upper = course.arena
        x, y = np.linspace(lower, upper, points).T
        return cls(x, y)

    @property
    def places(self) -> Places:
        """All points, those of a row one after the other [L]."""
        return np.stack(np.meshgrid(self.x, self.y), axis=-1).reshape(-1, 2)

    def lay(self, values: Float[np.ndarray, "place 2"]) -> Float[np.ndarray, "y x 2"]:
        """Values at `places` as a map."""
        return np.asarray(values, float).reshape(len(self.y), len(self.x), 2)

    def field(
        self,
        force: Callable[[Places], Float[np.ndarray, "place 2"]],
        distance: Float[np.ndarray, " place"] | None = None,
    ) -> FieldMap:
        """A force on the grid.

        Args:
            force: takes positions.
            distance: of each of `places` from the data [L]; zeros unless given.
        """
        shape = len(self.y), len(self.x)
        far = np.zeros(shape) if distance is None else distance.reshape(shape)
        return FieldMap(self.x, self.y, self.lay(force(self.places)), far)


@dataclasses.dataclass(frozen=True, eq=False)
class ForceMaps:
    """Forces on the arena.

    Attributes:
        sd: standard deviation of each component of the learned one [L T⁻²], where it is
            known.
    """

    learned: FieldMap
    truth: FieldMap | None = None
    sd: Float[np.ndarray, "y x 2"] | None = None
