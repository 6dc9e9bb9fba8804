r"""The quickest way through a current that is known, by shooting.

A swimmer of speed V in a steady current u(x) in the plane, $\dot x = V n(\theta) +
u(x)$, is quickest on an extremal of Zermelo's problem, on which the heading turns as

$$\dot\theta = \sin^2\theta\, \partial_x u_y + \sin\theta \cos\theta\,
(\partial_x u_x - \partial_y u_y) - \cos^2\theta\, \partial_y u_x .$$

An extremal meets a disc around the goal at right angles to its edge, in the heading.
So first heading and time are the roots of $x(T) + r n(\theta(T)) = g$: two equations,
solved from every local approach of a fan of extremals. This says nothing of walls.
"""

import math
from collections.abc import Callable, Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import root

from pinav.arguments import Planar, Scalar
from pinav.dynamics import RK4, FixedStep
from pinav.errors import FitError, InputError
from pinav.navigation.task.steering import direction, greatest_thrust
from pinav.navigation.task.task import ReachGoal, Task

Current = Callable[[Planar], Planar]
"""Velocity of the fluid [L T⁻¹] at a position [L]."""

FAN = 720
"""First headings that are tried."""

STEPS = 400
"""Runge-Kutta steps until the longest time."""


class Crossing(eqx.Module):
    """The quickest way.

    Attributes:
        time: of arrival [T].
        heading: the first one [rad].
        ts: times on the way [T].
        xs: positions then [L].
        headings: then [rad].
    """

    time: float
    heading: float
    ts: Float[np.ndarray, " time"]
    xs: Float[np.ndarray, "time 2"]
    headings: Float[np.ndarray, " time"]


def turning_rate(
    current: Current, x: Planar, heading: Float[Array, ""]
) -> Float[Array, ""]:
    """Rate at which the heading of an extremal turns [rad T⁻¹].

    Args:
        current: velocity of the fluid.
        x: position [L].
        heading: now [rad].

    References:
        Zermelo, Z. Angew. Math. Mech. 11, 114 (1931); Bryson and Ho, Applied Optimal
        Control, section 2.7.
    """
    slope = jax.jacfwd(current)(x)
    cos, sin = jnp.cos(heading), jnp.sin(heading)
    stretch = sin * cos * (slope[0, 0] - slope[1, 1])
    return sin**2 * slope[1, 0] + stretch - cos**2 * slope[0, 1]


def quickest(
    current: Current,
    start: Planar,
    goal: Planar,
    *,
    speed: float,
    longest: float,
    tolerance: float = 0.0,
) -> Crossing:
    """The quickest way from a place to another.

    Args:
        current: velocity of the fluid, steady.
        start: [L].
        goal: [L].
        speed: of the swimmer relative to the fluid [L T⁻¹], positive.
        longest: no way takes longer than this [T], positive.
        tolerance: radius of the disc around the goal that has to be reached [L].

    Raises:
        InputError: `speed` or `longest` is not positive, or `tolerance` is negative.
        FitError: no extremal arrives in that time.
    """
    if not (speed > 0 and longest > 0 and tolerance >= 0):
        raise InputError(
            "quickest: expected speed > 0, longest > 0 and tolerance >= 0, got "
            f"{speed}, {longest} and {tolerance}"
        )
    extremal = _Extremal(current, start, speed, longest)
    headings = jnp.linspace(0.0, 2 * math.pi, FAN, endpoint=False)
    fan = np.asarray(eqx.filter_jit(eqx.filter_vmap(extremal))(headings))
    cos, sin = np.cos(fan[..., 2]), np.sin(fan[..., 2])
    ends = fan[..., :2] + tolerance * np.stack([cos, sin], axis=-1)
    misses = np.linalg.norm(ends - np.asarray(goal), axis=-1)
    best = math.inf, math.nan

    def miss(unknown: Planar) -> Planar:
        y = extremal.until(unknown[0], unknown[1] * longest)[-1]
        return y[:2] + tolerance * direction(y[2:]) - goal

    residual = jax.jit(miss)
    for row, column in _approaches(misses):
        guess = np.array([float(headings[row]), column / STEPS])
        if guess[1] * longest > best[0] + longest / 20:
            continue
        solution = root(residual, guess, method="hybr", tol=1e-12)
        time = float(solution.x[1]) * longest
        if solution.success and 0 < time < best[0]:
            best = time, float(solution.x[0])
    if not best[0] <= longest:
        raise FitError(
            f"quickest: no extremal reaches {np.asarray(goal).tolist()} within "
            f"{longest}; give it more time or more speed"
        )
    return _crossing(extremal, *best)


def quickest_of_task(task: Task) -> Crossing:
    """The quickest way of a task without inertia, noise, walls and delay.

    The current is what moves the true swimmer without thrust, at t = 0.

    Raises:
        InputError: the task has inertia, follows a path, or has zones to keep out of.
        FitError: no extremal arrives before the time is up.
    """
    objective = task.objective
    plain = isinstance(objective, ReachGoal) and task.start.shape == (2,)
    if not isinstance(objective, ReachGoal) or not plain or task.keep_out:
        raise InputError(
            f"quickest_of_task: task {task.name!r} has inertia, a path or zones to "
            "keep out of; expected a place to reach, without inertia and zones"
        )
    return quickest(
        lambda x: task.truth(0.0, x, jnp.zeros(2)),
        task.start,
        objective.goal,
        speed=float(greatest_thrust(task.truth.actuator, task.limits)),
        longest=task.time_limit,
        tolerance=float(objective.tolerance),
    )


class _Extremal(eqx.Module):
    """The extremal of a first heading: states (x, heading) over time."""

    current: Current
    start: Planar
    speed: float
    longest: float

    def __call__(self, heading: Float[Array, ""]) -> Float[Array, "time 3"]:
        return self.until(heading, self.longest)

    def until(self, heading: Scalar, time: Scalar) -> Float[Array, "time 3"]:
        """States up to a time, in `STEPS` steps."""
        ts = jnp.linspace(0.0, 1.0, STEPS + 1) * time
        first = jnp.append(self.start, heading)
        return FixedStep(RK4).solve(self._rate, first, ts)[0]

    def _rate(self, t: Scalar, y: Float[Array, "3"]) -> Float[Array, "3"]:
        x, heading = y[:2], y[2]
        velocity = self.speed * direction(heading[None]) + self.current(x)
        return jnp.append(velocity, turning_rate(self.current, x, heading))


def _approaches(misses: Float[np.ndarray, "heading time"]) -> Iterator[tuple[int, int]]:
    """Where in the fan the goal is missed by least, locally; the early ones first."""
    inner = misses[:, 1:-1]
    least = (inner <= misses[:, :-2]) & (inner <= misses[:, 2:])
    for neighbour in (1, -1):
        least &= inner <= np.roll(inner, neighbour, axis=0)
    rows, columns = np.nonzero(least)
    order = np.argsort(columns)
    return zip(rows[order], columns[order] + 1, strict=True)


def _crossing(extremal: _Extremal, time: float, heading: float) -> Crossing:
    states = np.asarray(eqx.filter_jit(extremal.until)(jnp.asarray(heading), time))
    ts = np.linspace(0.0, time, STEPS + 1)
    return Crossing(time, heading, ts, states[:, :2], states[:, 2])
