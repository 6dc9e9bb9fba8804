"""The quickest way of a swimmer with inertia, by CasADi and IPOPT.

Direct multiple shooting, written down anew in CasADi's own expressions: an independent
reference for controllers, on the true model and without noise. Needs the extra `bench`.
"""

import importlib
import importlib.util
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.dynamics import Swimmer
from pinav.errors import FitError, InputError
from pinav.forces import AbstractForce, GaussianBarrier, LinearDrag
from pinav.navigation.task.steering import greatest_thrust
from pinav.navigation.task.task import Disc, ReachGoal, Task

INTERVALS = 80
"""Of constant thrust."""

DETOURS = (-0.5, -0.25, 0.0, 0.25, 0.5)
"""First guesses: arcs that leave the straight line by this fraction of its length."""

Way = tuple[float, Float[np.ndarray, "time 4"], Float[np.ndarray, "interval 2"]]
"""Time of arrival, states and thrusts of a local optimum."""


class QuickestWay(eqx.Module):
    """A local optimum: the best that was found.

    Attributes:
        time: of arrival [T].
        states: at the ends of the intervals, positions and velocities.
        thrusts: during each interval [L T⁻²].
        times: times of arrival from every first guess that converges [T].
    """

    time: float
    states: Float[np.ndarray, "time 4"]
    thrusts: Float[np.ndarray, "interval 2"]
    times: tuple[float, ...]


def is_available() -> bool:
    """Whether CasADi is installed."""
    return importlib.util.find_spec("casadi") is not None


def minimum_time(task: Task, *, intervals: int = INTERVALS) -> QuickestWay:
    """The quickest way of a task without noise and delay, from several first guesses.

    Args:
        task: with inertia, Gaussian barriers, linear drag and discs to keep out of.
        intervals: of constant thrust.

    Raises:
        InputError: the task is of another kind.
        FitError: CasADi is not installed, or no first guess converges.
    """
    problem = _Problem.of(task)
    if not is_available():
        raise FitError("CasADi is not installed; pip install 'pinav[peers]'")
    solve = _program(importlib.import_module("casadi"), problem, intervals)
    ways = [way for detour in DETOURS if (way := solve(detour)) is not None]
    if not ways:
        raise FitError(f"minimum_time: IPOPT found no way for task {task.name!r}")
    best = min(ways, key=lambda way: way[0])
    return QuickestWay(*best, times=tuple(way[0] for way in ways))


class _Problem(eqx.Module):
    """A task in plain numbers."""

    damping: float
    barriers: list[tuple[float, np.ndarray, float]]
    discs: list[tuple[np.ndarray, float]]
    start: np.ndarray
    goal: np.ndarray
    tolerance: float
    strongest: float
    longest: float

    @classmethod
    def of(cls, task: Task) -> "_Problem":
        swimmer, objective = task.truth.dynamics, task.objective
        discs = [zone for zone in task.keep_out if isinstance(zone, Disc)]
        if (
            not isinstance(swimmer, Swimmer)
            or not isinstance(swimmer.drag, LinearDrag)
            or not isinstance(objective, ReachGoal)
            or len(discs) < len(task.keep_out)
        ):
            raise InputError(
                f"minimum_time: task {task.name!r} has no inertia, another drag, a "
                "path or walls; expected a place to reach with linear drag and discs"
            )
        return cls(
            float(swimmer.drag.damping),
            _barriers(swimmer.environment),
            [(np.asarray(disc.center), float(disc.radius)) for disc in discs],
            np.asarray(task.start),
            np.asarray(objective.goal),
            float(objective.tolerance),
            float(greatest_thrust(task.truth.actuator, task.limits)),
            task.time_limit,
        )


def _barriers(environment: AbstractForce) -> list[tuple[float, np.ndarray, float]]:
    """Height, centre and width of each barrier."""
    barriers = []
    for each in getattr(environment, "terms", (environment,)):
        if not isinstance(each, GaussianBarrier):
            raise InputError(
                f"minimum_time: expected Gaussian barriers, got {type(each).__name__}"
            )
        barriers.append(
            (float(each.height), np.asarray(each.center), float(each.width))
        )
    return barriers


def _rate(casadi: Any, problem: _Problem) -> Any:
    """CasADi's function of state and thrust."""
    y, thrust = casadi.SX.sym("y", 4), casadi.SX.sym("u", 2)
    acceleration = thrust - problem.damping * y[2:]
    for height, center, width in problem.barriers:
        offset = (y[:2] - center) / width
        push = height / width * casadi.exp(-casadi.sumsqr(offset) / 2)
        acceleration += push * offset
    return casadi.Function("rate", [y, thrust], [casadi.vertcat(y[2:], acceleration)])


def _step(rate: Any, y: Any, thrust: Any, h: Any) -> Any:
    k1 = rate(y, thrust)
    k2 = rate(y + h / 2 * k1, thrust)
    k3 = rate(y + h / 2 * k2, thrust)
    k4 = rate(y + h * k3, thrust)
    return y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def _program(
    casadi: Any, problem: _Problem, intervals: int
) -> Callable[[float], Way | None]:
    """A function from a first guess to its local optimum, or None."""
    program = casadi.Opti()
    time = program.variable()
    ys, thrusts = program.variable(4, intervals + 1), program.variable(2, intervals)
    program.minimize(time)
    program.subject_to(program.bounded(0.1, time, problem.longest))
    program.subject_to(ys[:, 0] == problem.start)
    miss = casadi.sumsqr(ys[:2, intervals] - problem.goal)
    program.subject_to(miss <= problem.tolerance**2)
    rate = _rate(casadi, problem)
    for k in range(intervals):
        later = _step(rate, ys[:, k], thrusts[:, k], time / intervals)
        program.subject_to(ys[:, k + 1] == later)
        program.subject_to(casadi.sumsqr(thrusts[:, k]) <= problem.strongest**2)
        for center, radius in problem.discs:
            away = casadi.sumsqr(ys[:2, k + 1] - center)
            program.subject_to(away >= radius**2)
    quiet = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"}
    program.solver("ipopt", quiet, {"max_iter": 400})

    def solve(detour: float) -> Way | None:
        guess = _arc(problem.start[:2], problem.goal, detour, intervals + 1)
        span = problem.longest / 2
        slope = np.gradient(guess, axis=0).T * intervals / span
        program.set_initial(time, span)
        program.set_initial(ys, np.concatenate([guess.T, slope]))
        program.set_initial(thrusts, 0.0)
        try:
            solution = program.solve()
        except RuntimeError:  # IPOPT's way to say that it did not converge
            return None
        duration, states, pushes = (solution.value(v) for v in (time, ys, thrusts))
        return float(duration), np.asarray(states).T, np.asarray(pushes).T

    return solve


def _arc(
    start: Float[np.ndarray, "2"],
    goal: Float[np.ndarray, "2"],
    detour: float,
    count: int,
) -> Float[np.ndarray, "point 2"]:
    """Points of a sine arc from start to goal."""
    parts = np.linspace(0.0, 1.0, count)[:, None]
    along = goal - start
    across = detour * np.array([-along[1], along[0]])
    return start + parts * along + np.sin(math.pi * parts) * across
