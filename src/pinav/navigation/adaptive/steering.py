"""The controller that learns: each frame changes its belief, and often its plan."""

import dataclasses
import math
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from pinav.errors import InputError
from pinav.navigation.adaptive.known import motion_of, with_known
from pinav.navigation.adaptive.progress import Progress
from pinav.navigation.adaptive.safety import Verdict, check_command
from pinav.navigation.adaptive.strategies import (
    AbstractStrategy,
    Curious,
)
from pinav.navigation.belief.belief import Belief, Frame
from pinav.navigation.belief.motion import InertialMotion, OverdampedMotion
from pinav.navigation.belief.prior import ForcePrior
from pinav.navigation.control.compensation import Timing
from pinav.navigation.control.controller import (
    AbstractController,
    Controls,
    Observation,
)
from pinav.navigation.control.costs import ArrivalCost
from pinav.navigation.control.mppi import PathIntegral
from pinav.navigation.control.prediction import GradientGuide, TrajectoryPrediction
from pinav.navigation.control.simple import physics_only
from pinav.navigation.model.predictors import AbstractPredictor, InertialTable
from pinav.navigation.model.tabulated import (
    TabulatedModel,
    greatest_rate,
    tabulate_model,
)
from pinav.navigation.planning.plan import TimeToGo, check_places
from pinav.navigation.planning.replanning import HEADROOM, Replanner
from pinav.navigation.task.objectives import ReachGoal
from pinav.navigation.task.steering import Command
from pinav.navigation.task.task import Task
from pinav.navigation.task.zones import Rectangle

POINTS, SPEEDS = 25, 11
"""Points of the lattice along the arena and along a velocity, with inertia."""

FLAT_POINTS = 61
"""Points of the lattice along the arena, without inertia."""

EVERY = 0.04
"""Time between two plans, over the time to cross the arena."""

HORIZON = 0.3
"""How far the last filter looks, over the time to cross the arena."""

PATIENCE = 0.5
"""How long a swimmer may come nowhere new, over the time to cross the arena."""

SWEEPS = 12
"""Sweeps of a plan from the values before."""

CHANGED = 48
"""Sweeps of a plan after the leader has changed: its old values may be far too high."""

WINDOW = 0.3
"""Half of the finer lattice about the goal, over the longer side of the arena."""

FINER = 0.6
"""Cells of the finer lattice over the whole arena, in those of the usual one."""

NEW = 0.06
"""Distance from old places that makes a place new, over the arena's longer side."""

STEPS = 20
"""Steps that the control looks ahead."""


@dataclasses.dataclass(frozen=True, eq=False)
class Mind:
    """What the controller remembers from frame to frame.

    Attributes:
        belief: of state and force.
        tables: on which the last plan was made.
        plan: the last one.
        prediction: of sequences of controls on these tables.
        controller: follows the plan.
        lattice: on which it stands.
        controls: sequence that is kept.
        planned: when the plan was made [T].
        leader: of the bank at that time.
        progress: where the swimmer was, and whether it comes to new places.
        verdict: of the safety filter on the last command.
        replan_time: computing time of the last plan [s].
    """

    belief: Belief
    tables: TabulatedModel
    plan: TimeToGo
    prediction: TrajectoryPrediction
    controller: AbstractController
    lattice: Replanner
    controls: Controls
    planned: float
    leader: int
    progress: Progress
    verdict: Verdict | None = None
    replan_time: float = 0.0


@dataclasses.dataclass(frozen=True, eq=False)
class Adaptive:
    """Steers to a place through a force that it learns on the way.

    Attributes:
        task: what is to be done; its truth is not used.
        strategy: how the plan deals with what is not known.
        physics: tables of what is known.
        motion: the same for the belief.
        thrust: greatest rate of the thrust.
        crossing: time to cross the arena, from top speed to rest included [T].
        replanner: over the arena.
        window: over the surroundings of the goal, with finer cells.
        detailed: over the arena with finer cells, for a swimmer that was stalled.
        safe: whether the last filter is in use.
        prior: what an earlier fit found; nothing is known unless given.
    """

    task: Task
    strategy: AbstractStrategy
    physics: TabulatedModel
    motion: InertialMotion | OverdampedMotion
    thrust: float
    crossing: float
    replanner: Replanner
    window: Replanner
    detailed: Replanner
    safe: bool = True
    prior: ForcePrior | None = None

    @classmethod
    def of(
        cls,
        task: Task,
        strategy: AbstractStrategy | None = None,
        *,
        safe: bool = True,
        points: int | None = None,
        speeds: int = SPEEDS,
    ) -> "Adaptive":
        """The controller of a task.

        Args:
            task: what is to be done.
            strategy: `Curious` unless given.
            safe: whether the last filter is used.
            points: of the lattice along the arena.
            speeds: the same along a velocity.

        Raises:
            InputError: the task is to follow a path; start or goal are forbidden.
        """
        if not isinstance(task.objective, ReachGoal):
            raise InputError(
                f"task {task.name!r}: learning on the way expected a place to reach, "
                f"got {type(task.objective).__name__}"
            )
        check_places(task)
        physics = tabulate_model(task, physics_only(task.truth))
        if len(physics.table.values) > 1:
            raise InputError(
                f"task {task.name!r}: learning on the way expected known forces and "
                "flows that do not change in time"
            )
        inertial = isinstance(physics.predictor, InertialTable)
        if points is None:
            points = POINTS if inertial else FLAT_POINTS
        objective = task.objective
        arena, more = task.arena, math.ceil((points - 1) / FINER) + 1
        parts = (
            (arena, points),
            (_window(task, objective), points),
            (arena, more),
        )
        lattices = [
            Replanner.of(
                task, objective, physics, points=count, speeds=speeds, window=window
            )
            for window, count in parts
        ]
        thrust = float(
            greatest_rate(physics.table, physics.control_map, inertial=inertial)
        )
        return cls(
            task,
            Curious() if strategy is None else strategy,
            physics,
            motion_of(task, physics),
            thrust,
            _crossing_time(task, lattices[0], thrust),
            *lattices,
            safe=safe,
        )

    def believe(self, frame: Frame) -> Belief:
        """The belief after the first frame of a swimmer that rests.

        Args:
            frame: the first one.
        """
        belief = Belief.start(
            frame,
            lower=np.asarray(self.task.arena.lower),
            upper=np.asarray(self.task.arena.upper),
            motion=self.motion,
            thrust=self.thrust,
            speed_sd=self.rest_sd(frame),
            longest=self.task.step,
        )
        return belief if self.prior is None else self.prior.lead(belief)

    def rest_sd(self, frame: Frame) -> float:
        """Standard deviation of a component of a resting swimmer's velocity [L T⁻¹].

        In a tenth of the time to cross the arena it goes as far as positions err.

        Args:
            frame: the first one.
        """
        return 10 * frame.sd / self.crossing

    def start(self, belief: Belief) -> Mind:
        """What is remembered before the first command; the first plan is complete."""
        tables = self.strategy.tables(belief, self.physics, self.thrust)
        plan = self.replanner.plan(tables)
        controls = jnp.zeros((STEPS, 2))
        state = belief.state.mean
        return Mind(
            belief,
            tables,
            plan,
            *_path_integral(plan, self.task.step),
            lattice=self.replanner,
            controls=controls,
            planned=belief.time,
            leader=belief.leader,
            progress=Progress(
                NEW * self.task.extent,
                state[None, :2],
                belief.time,
                state,
                PATIENCE * self.crossing,
            ),
        )

    def learn(self, mind: Mind, frame: Frame) -> Mind:
        """The mind after a frame: its belief, and the plan where one is due.

        Args:
            mind: before it.
            frame: with the mean thrust since the last one.
        """
        belief = mind.belief.after(with_known(frame, mind.belief, self.physics))
        progress = mind.progress.after(
            belief.time,
            belief.state.mean,
            lambda state: mind.plan.time_from(jnp.asarray(state)),
        )
        mind = dataclasses.replace(mind, belief=belief, progress=progress)
        every = EVERY * self.crossing
        if belief.time - mind.planned < every - self.task.step / 2:
            return mind
        return self.replan(mind)

    def replan(self, mind: Mind) -> Mind:
        """The mind with a new plan from the old values."""
        began, belief, progress = time.perf_counter(), mind.belief, mind.progress
        boldness = progress.boldness
        strategy = Curious(boldness=boldness) if boldness else self.strategy
        tables = strategy.tables(belief, self.physics, self.thrust)
        lattice = self._lattice(mind)
        changed = belief.leader != mind.leader
        sweeps = CHANGED if changed or progress.stalled else SWEEPS
        if lattice is mind.lattice:
            plan = lattice.plan(tables, mind.plan.values, sweeps=sweeps)
        else:
            plan = lattice.plan(tables)
        jax.block_until_ready(plan.values)
        prediction, controller = _path_integral(plan, self.task.step)
        return dataclasses.replace(
            mind,
            tables=tables,
            plan=plan,
            prediction=prediction,
            controller=controller,
            lattice=lattice,
            planned=belief.time,
            leader=belief.leader,
            replan_time=time.perf_counter() - began,
        )

    def command(
        self, mind: Mind, pending: Float[Array, "command 2"], key: PRNGKeyArray
    ) -> tuple[Command, Mind]:
        """The next command, through the safety filter.

        Args:
            mind: after the last frame.
            pending: as in `Observation`.
            key: random key of the control.
        """
        task, belief = self.task, mind.belief
        observation = Observation(
            jnp.asarray(belief.time), jnp.asarray(belief.state.mean), pending
        )
        timing = Timing(task.step, task.delay)
        ahead, command, controls = _decide(
            mind.controller,
            mind.tables.predictor,
            timing,
            observation,
            mind.controls,
            key,
        )
        mind = dataclasses.replace(mind, controls=controls)
        if not self.safe:
            return command, mind
        verdict = check_command(
            command,
            ahead,
            belief,
            mind.prediction,
            self.physics,
            mind.tables.time_cost,
            self.thrust,
            HORIZON * self.crossing,
        )
        return verdict.command, dataclasses.replace(mind, verdict=verdict)

    def _lattice(self, mind: Mind) -> Replanner:
        """The lattice for the next plan: finer where the goal or a trap is near."""
        grid, place = self.window.grid, mind.belief.state.mean[:2]
        lower = np.asarray(grid.lower)
        upper = lower + np.asarray(grid.spacing) * (np.array(grid.shape) - 1)
        within = mind.lattice is self.window
        edge = 0.0 if within else 2 * self.window.cell
        inside = bool(np.all((place > lower + edge) & (place < upper - edge)))
        narrow = mind.belief.length_scale < 2 * self.replanner.cell
        bold = mind.progress.boldness > 0
        if inside and (narrow or bold or within):
            return self.window
        return self.detailed if bold else self.replanner


def _crossing_time(task: Task, lattice: Replanner, thrust: float) -> float:
    """Time to cross the arena at top speed, and to stop from it by thrust alone [T].

    All that is done now and then, or looks ahead, is measured by it, so that nothing
    depends on the units of the task.
    """
    if lattice.velocities is None:
        return task.extent / thrust
    speed = float(lattice.velocities[-1]) / HEADROOM
    return task.extent / speed + speed / thrust


def _window(task: Task, objective: ReachGoal) -> Rectangle:
    """The part of the arena about the goal, of full size where there is room."""
    lower, upper = np.asarray(task.arena.lower), np.asarray(task.arena.upper)
    half = WINDOW * task.extent
    middle = np.clip(np.asarray(objective.goal), lower + half, upper - half)
    return Rectangle(middle - half, middle + half)


def _path_integral(
    plan: TimeToGo, step: float
) -> tuple[TrajectoryPrediction, AbstractController]:
    """What follows a plan, and its predictions."""
    tables = plan.tables
    prediction = TrajectoryPrediction(tables.predictor, tables.control_map, step, STEPS)
    return prediction, PathIntegral(prediction, ArrivalCost(plan), GradientGuide(plan))


@eqx.filter_jit
def _decide(
    controller: AbstractController,
    predictor: AbstractPredictor,
    timing: Timing,
    observation: Observation,
    memory: Controls,
    key: PRNGKeyArray,
) -> tuple[Observation, Command, Controls]:
    """The state when the command comes into force, the command, and the sequence."""
    ahead = timing.predict(predictor, observation) if timing.delay > 0 else observation
    command, controls = controller(ahead, memory, key=key)
    return ahead, command, controls
