r"""Splines through exact states, and the accelerations along them.

Where positions and velocities are observed, one spline passes through the positions
with the slopes that the velocities give: twice as many conditions as samples, so that
its error is that of samples half as far apart. Where samples are dense its second
derivative is less exact than the first derivative of a spline through the velocities;
the one that changes less with its degree is taken.

References:
    de Boor, A Practical Guide to Splines (2001), chapters IX and XIII.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy.sparse
from jaxtyping import Float

from pinav.trajectories import Trajectory

DEGREE = 7
"""Of the splines: exact states deserve more than a cubic."""

Table = Float[np.ndarray, "time channel"]
Curve = Callable[[Float[np.ndarray, " time"]], Table]


class PathSpline(NamedTuple):
    """A trajectory between its samples.

    Attributes:
        times: of the samples [T].
        states: at any times between the first and the last.
        rates: of change of the states there.
        doubts: lengths of the difference of these rates from those of a spline of a
            degree less by two.
    """

    times: Float[np.ndarray, " time"]
    states: Curve
    rates: Curve
    doubts: Callable[[Float[np.ndarray, " time"]], Float[np.ndarray, " time"]]


def path_spline(trajectory: Trajectory, dim: int) -> PathSpline | None:
    """The spline through the complete samples; None where there are too few.

    Args:
        trajectory: what was observed, without noise.
        dim: number of coordinates, which come first.
    """
    complete = trajectory.observed.all(axis=1)
    times, states = trajectory.times[complete], trajectory.states[complete]
    if len(times) <= DEGREE:
        return None
    kinds = [_through_states]
    if states.shape[1] == 2 * dim:
        kinds.append(_through_positions_and_slopes)
    paths = [_with_doubts(times, states, kind) for kind in kinds]
    return min(paths, key=lambda path: float(np.mean(path.doubts(times) ** 2)))


def _with_doubts(
    times: Float[np.ndarray, " time"],
    states: Table,
    kind: Callable[..., tuple[Curve, Curve]],
) -> PathSpline:
    curve, rates = kind(times, states, DEGREE)
    others = kind(times, states, DEGREE - 2)[1]
    return PathSpline(
        times, curve, rates, lambda t: np.linalg.norm(rates(t) - others(t), axis=1)
    )


def _through_states(
    times: Float[np.ndarray, " time"], states: Table, degree: int
) -> tuple[Curve, Curve]:
    from scipy.interpolate import make_interp_spline  # a tenth of all imports

    spline = make_interp_spline(times, states, k=degree)
    return spline, spline.derivative()


def _through_positions_and_slopes(
    times: Float[np.ndarray, " time"], states: Table, degree: int
) -> tuple[Curve, Curve]:
    from scipy.interpolate import BSpline
    from scipy.sparse.linalg import spsolve

    half, count = (degree + 1) // 2, 2 * len(times)
    inner = np.repeat(times, 2)[half:-half]
    first, last = np.full(degree + 1, times[0]), np.full(degree + 1, times[-1])
    knots = np.concatenate([first, inner, last])
    values = BSpline.design_matrix(times, knots, degree)
    scale = degree / (knots[degree + 1 : degree + count] - knots[1:count])
    here = scipy.sparse.eye_array(count - 1, count)
    next_one = scipy.sparse.eye_array(count - 1, count, k=1)
    differences = scipy.sparse.diags_array(scale) @ (next_one - here)
    slopes = BSpline.design_matrix(times, knots[1:-1], degree - 1) @ differences
    in_turns = np.arange(count).reshape(2, -1).T.ravel()
    rows = scipy.sparse.vstack([values, slopes]).tocsr()[in_turns]
    targets = np.stack(np.split(states, 2, axis=1), axis=1).reshape(count, -1)
    position = BSpline(knots, spsolve(rows.tocsc(), targets), degree)
    velocity, acceleration = position.derivative(), position.derivative(2)
    return (
        lambda t: np.concatenate([position(t), velocity(t)], axis=1),
        lambda t: np.concatenate([velocity(t), acceleration(t)], axis=1),
    )


def quadrature_error(path: PathSpline) -> float:
    """Relative error of a step of fourth order between samples at most.

    That of Simpson's rule on the rates along the path, one interval against two.
    """
    interval = np.diff(path.times)
    parts = np.stack(
        [path.rates(path.times[:-1] + part * interval) for part in QUARTERS]
    )
    one, two = np.tensordot(SIMPSON, parts, axes=1)
    missed = interval[:, None] * np.abs(one - two)
    size = np.sqrt(np.mean(np.square(path.states(path.times)), axis=0))
    return float(np.max(missed / np.where(size > 0, size, np.inf)))


QUARTERS = (0.0, 0.25, 0.5, 0.75, 1.0)
SIMPSON = np.array([[2, 0, 8, 0, 2], [1, 4, 2, 4, 1]]) / 12.0
"""Weights of Simpson's rule on one interval and on two."""
