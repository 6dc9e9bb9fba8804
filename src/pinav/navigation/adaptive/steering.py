"""The controller that learns: each frame changes its belief, and often its plan."""

import dataclasses
import math
import time
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from pinav.errors import InputError
from pinav.navigation import predictors
from pinav.navigation.adaptive.safety import CommandVerdict, check_command
from pinav.navigation.adaptive.strategies import (
    ExplorationBonus,
    Progress,
    motion_of,
    with_known,
)
from pinav.navigation.belief.belief import Belief, Frame
from pinav.navigation.belief.motion import AbstractMotion, Vector
from pinav.navigation.control.controller import (
    AbstractController,
    ArrivalCost,
    Controls,
    GradientGuide,
    Observation,
    TrajectoryPrediction,
)
from pinav.navigation.control.default import predict_onset
from pinav.navigation.control.mppi import PathIntegral
from pinav.navigation.planning.plan import Planner, TimeToGo, check_places
from pinav.navigation.task.steering import Command, physics_only
from pinav.navigation.task.task import ReachGoal, Rectangle, Task, Timing
from pinav.navigation.trials.situation import mean_thrust

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

HEADROOM = 1.25
"""Greatest speed of the lattice over that of the thrust against the drag alone."""

TO_THE_END = 400
"""Sweeps after which any plan has settled."""

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
class ControllerState:
    """The memory of the controller between two frames.

    Attributes:
        planned: time at which the plan was made [T].
        pending: commands that waited at the last decision, as in `Observation`.
        verdict: of the safety filter on the last command; none before the first.
        learn_time: computing time of the last frame [s]; NaN for the first one.
        plan_time: computing time of a plan that this frame made [s]; NaN without one.
        command_time: computing time of the last command [s].
    """

    belief: Belief
    plan: TimeToGo
    lattice: Planner
    planned: float
    leader: int
    controls: Controls
    progress: Progress
    pending: Float[Array, "command 2"]
    verdict: CommandVerdict | None = None
    learn_time: float = math.nan
    plan_time: float = math.nan
    command_time: float = math.nan


class AdaptiveController(AbstractController[ControllerState]):
    """Steers to a place through a force that it learns on the way.

    Its memory is its belief, and the plan that was made on it. It observes positions
    alone. It decides in Python: its calls can be neither traced nor batched.

    Attributes:
        strategy: treatment of what is not known in the plan.
        thrust: greatest rate of the thrust [L T⁻²], or [L T⁻¹] without inertia.
        crossing: time to cross the arena, from top speed to rest included [T].
        window: lattice about the goal, with finer cells.
        detailed: lattice over the arena with finer cells, for a swimmer that stalled.
        known: belief whose map is kept, such as that of an earlier visit or of a fit;
            nothing is known of the force unless given.
    """

    task: Task
    strategy: ExplorationBonus
    physics: predictors.TabulatedModel
    motion: AbstractMotion
    thrust: float
    crossing: float
    replanner: Planner
    window: Planner
    detailed: Planner
    known: Belief | None = None

    @classmethod
    def of(
        cls,
        task: Task,
        strategy: ExplorationBonus | None = None,
        *,
        points: int | None = None,
        speeds: int = SPEEDS,
    ) -> "AdaptiveController":
        """The controller of a task.

        Raises:
            InputError: the task is to follow a path; start or goal are forbidden.
        """
        if not isinstance(task.objective, ReachGoal):
            raise InputError(
                f"task {task.name!r}: learning on the way expected a place to reach, "
                f"got {type(task.objective).__name__}"
            )
        check_places(task)
        physics = predictors.tabulate_model(task, physics_only(task.truth))
        if len(physics.table.values) > 1:
            raise InputError(
                f"task {task.name!r}: learning on the way expected known forces and "
                "flows that do not change in time"
            )
        inertial = isinstance(physics.predictor, predictors.InertialTable)
        if points is None:
            points = POINTS if inertial else FLAT_POINTS
        objective, finer = task.objective, math.ceil((points - 1) / FINER) + 1
        lattice = partial(
            Planner.of, task, objective, physics, speeds=speeds, headroom=HEADROOM
        )
        replanner = lattice(points=points)
        thrust = float(
            predictors.greatest_rate(
                physics.table, physics.control_map, inertial=inertial
            )
        )
        return cls(
            task,
            ExplorationBonus() if strategy is None else strategy,
            physics,
            motion_of(task, physics),
            thrust,
            _crossing_time(task, replanner, thrust),
            replanner,
            window=lattice(points=points, region=_window(task, objective)),
            detailed=lattice(points=finer),
        )

    @property
    def first_frame(self) -> Frame:
        """The start of the task, as it would be seen without an error."""
        start = np.asarray(self.task.start[:2], float)
        return Frame(0.0, start, self.task.position_sd, np.zeros(2))

    def believe(self, frame: Frame) -> Belief:
        """The belief after the first frame of a swimmer that rests."""
        if self.known is not None:
            return self.known.restart(frame, speed_sd=self.rest_sd(frame))
        return Belief.start(
            frame,
            lower=np.asarray(self.task.arena.lower),
            upper=np.asarray(self.task.arena.upper),
            motion=self.motion,
            thrust=self.thrust,
            speed_sd=self.rest_sd(frame),
            longest=self.task.step,
        )

    def rest_sd(self, frame: Frame) -> float:
        """Standard deviation of a component of a resting swimmer's velocity [L T⁻¹].

        In a tenth of the time to cross the arena it goes as far as positions err.
        """
        return 10 * frame.sd / self.crossing

    def start(self, observation: Observation) -> ControllerState:
        belief = self.believe(self._frame(observation, np.zeros(2)))
        return self.begin(belief, observation.pending)

    def __call__(
        self, observation: Observation, memory: ControllerState, *, key: PRNGKeyArray
    ) -> tuple[Command, ControllerState]:
        if observation.time > memory.belief.time:
            memory = self.learn(memory, observation)
        return self._decide(memory, observation.pending, key)

    def begin(
        self, belief: Belief, pending: Float[Array, "command 2"]
    ) -> ControllerState:
        """The memory before the first command; the first plan is complete."""
        tables = self.strategy.tables(belief, self.physics, self.thrust)
        state = belief.state.mean
        return ControllerState(
            belief=belief,
            plan=self.replanner.plan(tables, sweeps=TO_THE_END),
            lattice=self.replanner,
            planned=belief.time,
            leader=belief.leader,
            controls=jnp.zeros((STEPS, 2)),
            progress=Progress(
                NEW * self.task.extent,
                state[None, :2],
                belief.time,
                state,
                PATIENCE * self.crossing,
            ),
            pending=pending,
        )

    def learn(
        self, memory: ControllerState, observation: Observation
    ) -> ControllerState:
        """The memory after a frame: its belief, and the plan where one is due."""
        began = time.perf_counter()
        queue = jnp.concatenate([memory.pending[:1], observation.pending])
        frame = self._frame(observation, mean_thrust(self.task, queue))
        belief = memory.belief.after(with_known(frame, memory.belief, self.physics))
        progress = memory.progress.after(
            belief.time,
            belief.state.mean,
            lambda state: memory.plan.time_from(jnp.asarray(state)),
        )
        memory = dataclasses.replace(
            memory,
            belief=belief,
            progress=progress,
            learn_time=time.perf_counter() - began,
            plan_time=math.nan,
        )
        every = EVERY * self.crossing
        if belief.time - memory.planned < every - self.task.step / 2:
            return memory
        return self.replan(memory)

    def replan(self, memory: ControllerState) -> ControllerState:
        """The memory with a new plan from the old values."""
        began, belief, progress = time.perf_counter(), memory.belief, memory.progress
        boldness = progress.boldness
        strategy = ExplorationBonus(boldness=boldness) if boldness else self.strategy
        tables = strategy.tables(belief, self.physics, self.thrust)
        lattice = self._lattice(memory)
        changed = belief.leader != memory.leader
        sweeps = CHANGED if changed or progress.stalled else SWEEPS
        if lattice is memory.lattice:
            plan = lattice.plan(tables, memory.plan.values, sweeps=sweeps)
        else:
            plan = lattice.plan(tables, sweeps=TO_THE_END)
        jax.block_until_ready(plan.values)
        return dataclasses.replace(
            memory,
            plan=plan,
            lattice=lattice,
            planned=belief.time,
            leader=belief.leader,
            plan_time=time.perf_counter() - began,
        )

    def _frame(self, observation: Observation, thrust: Vector) -> Frame:
        """The position of an observation, with the mean thrust since the last one."""
        position = np.asarray(observation.state[:2], float)
        return Frame(float(observation.time), position, self.task.position_sd, thrust)

    def _decide(
        self,
        memory: ControllerState,
        pending: Float[Array, "command 2"],
        key: PRNGKeyArray,
    ) -> tuple[Command, ControllerState]:
        """The next command, through the safety filter."""
        began, task, belief = time.perf_counter(), self.task, memory.belief
        tables = memory.plan.tables
        prediction = TrajectoryPrediction(
            tables.predictor, tables.control_map, task.step, STEPS
        )
        observation = Observation(
            jnp.asarray(belief.time), jnp.asarray(belief.state.mean), pending
        )
        ahead, command, controls = _follow(
            PathIntegral(
                prediction, ArrivalCost(memory.plan), GradientGuide(memory.plan)
            ),
            task.timing,
            observation,
            memory.controls,
            key,
        )
        verdict = check_command(
            command,
            ahead,
            belief,
            prediction,
            self.physics,
            tables.time_cost,
            self.thrust,
            HORIZON * self.crossing,
        )
        return verdict.command, dataclasses.replace(
            memory,
            controls=controls,
            pending=pending,
            verdict=verdict,
            command_time=time.perf_counter() - began,
        )

    def _lattice(self, memory: ControllerState) -> Planner:
        """The lattice for the next plan: finer where the goal or a trap is near."""
        grid, place = self.window.grid, memory.belief.state.mean[:2]
        lower = np.asarray(grid.lower)
        upper = lower + np.asarray(grid.spacing) * (np.array(grid.shape) - 1)
        within = memory.lattice is self.window
        edge = 0.0 if within else 2 * self.window.cell
        inside = bool(np.all((place > lower + edge) & (place < upper - edge)))
        narrow = memory.belief.length_scale < 2 * self.replanner.cell
        bold = memory.progress.boldness > 0
        if inside and (narrow or bold or within):
            return self.window
        return self.detailed if bold else self.replanner


def _crossing_time(task: Task, lattice: Planner, thrust: float) -> float:
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


@eqx.filter_jit
def _follow(
    controller: PathIntegral,
    timing: Timing,
    observation: Observation,
    memory: Controls,
    key: PRNGKeyArray,
) -> tuple[Observation, Command, Controls]:
    """The state when the command comes into force, the command, and the sequence."""
    predictor, ahead = controller.prediction.predictor, observation
    if timing.delay > 0:
        ahead = predict_onset(predictor, timing, observation)
    command, controls = controller(ahead, memory, key=key)
    return ahead, command, controls
