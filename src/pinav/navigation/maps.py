"""The places of a task, as maps show them."""

import dataclasses

import numpy as np
from jaxtyping import Float

from pinav.evaluation import FieldMap
from pinav.navigation.task.task import Disc, ReachGoal, Task


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

    def grid(self, points: int) -> FieldMap:
        """A map of no force, with so many points along each side of the arena."""
        lower, upper = self.arena
        x, y = np.linspace(lower, upper, points).T
        shape = len(y), len(x)
        return FieldMap(x, y, np.zeros((*shape, 2)), np.zeros(shape))
