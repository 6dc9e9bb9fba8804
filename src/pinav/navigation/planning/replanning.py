"""Plans again and again while the model changes, on one lattice, from old values."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from pinav.navigation.planning.lattice import (
    arrival_test,
    phase_step,
    phase_values,
    position_step,
    position_values,
    top_speed,
)
from pinav.navigation.planning.plan import (
    HEADINGS,
    PHASE_HEADINGS,
    TimeToGo,
    assemble_plan,
)
from pinav.navigation.planning.value_iteration import ArrivalTest
from pinav.navigation.predictors import InertialTable, TabulatedModel
from pinav.navigation.tables import Grid
from pinav.navigation.task.task import ReachGoal, Rectangle, Task

HEADROOM = 1.25
"""Greatest speed of the lattice over that of the thrust against the drag alone."""

TO_THE_END = 400
"""Sweeps after which any plan has settled."""


class Replanner(eqx.Module):
    """A lattice that stays while tables and values change: compiled once.

    It never refuses a goal that seems out of reach: what is believed of the moment may
    close every way, and the next frame may open one.

    Attributes:
        task: what is to be done; its truth is not used.
        velocities: along either axis, where there is inertia [L T⁻¹]; else None.
    """

    task: Task
    objective: ReachGoal
    grid: Grid
    velocities: Float[Array, " velocity"] | None

    @classmethod
    def of(
        cls,
        task: Task,
        objective: ReachGoal,
        physics: TabulatedModel,
        *,
        points: int,
        speeds: int = 11,
        window: Rectangle,
    ) -> "Replanner":
        """The lattice of a task."""
        grid = Grid.over(window, points)
        if not isinstance(physics.predictor, InertialTable):
            return cls(task, objective, grid, None)
        arrival = arrival_test(
            objective, task.time_limit, physics, grid, PHASE_HEADINGS
        )
        top = HEADROOM * top_speed(task, physics, arrival)
        return cls(task, objective, grid, jnp.linspace(-top, top, speeds))

    @property
    def cell(self) -> float:
        """Longer side of a cell [L]."""
        return float(jnp.max(self.grid.spacing))

    def plan(
        self,
        tables: TabulatedModel,
        begin: Float[Array, "moment ..."] | None = None,
        *,
        sweeps: int = TO_THE_END,
    ) -> TimeToGo:
        """The plan after some sweeps.

        Args:
            tables: of what is believed.
            begin: values of the last plan; zeros unless given.
            sweeps: at most; fewer where the values have settled.
        """
        if self.velocities is None:
            return self._over_positions(tables, begin, sweeps)
        velocities = self.velocities
        arrival = self._arrival(tables, PHASE_HEADINGS)
        if begin is None:
            count = velocities.shape[0]
            begin = jnp.zeros((1, count, count, *self.grid.shape), jnp.float32)
        step = phase_step(arrival, velocities)
        values = phase_values(
            tables.table,
            arrival,
            self.grid,
            velocities,
            (step, jnp.asarray(sweeps)),
            None,
            begin,
        )
        width = velocities[1] - velocities[0]
        lower = jnp.concatenate([jnp.full(2, velocities[0]), self.grid.lower])
        spacing = jnp.concatenate([jnp.full(2, width), self.grid.spacing])
        return assemble_plan(self.task, tables, arrival, values, (lower, spacing), step)

    def _over_positions(
        self,
        tables: TabulatedModel,
        begin: Float[Array, "moment ..."] | None,
        sweeps: int,
    ) -> TimeToGo:
        arrival = self._arrival(tables, HEADINGS[self.task.dim])
        if begin is None:
            begin = jnp.zeros((1, *self.grid.shape), jnp.float32)
        step = position_step(tables.table, arrival, self.grid)
        values = position_values(
            tables.table,
            arrival,
            self.grid,
            step,
            None,
            begin,
            jnp.asarray(sweeps),
        )
        lattice = (self.grid.lower, self.grid.spacing)
        return assemble_plan(self.task, tables, arrival, values, lattice, step)

    def _arrival(self, tables: TabulatedModel, headings: int) -> ArrivalTest:
        return arrival_test(
            self.objective, self.task.time_limit, tables, self.grid, headings
        )
