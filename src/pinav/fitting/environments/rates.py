r"""Splines through exact states: rates, accelerations, and the force beside physics.

Where positions and velocities are observed, one spline passes through the positions
with the slopes that the velocities give: twice as many conditions as samples, so that
its error is that of samples half as far apart. Where samples are dense its second
derivative is less exact than the first derivative of a spline through the velocities;
the one that changes less with its degree is taken.

References:
    de Boor, A Practical Guide to Splines (2001), chapters IX and XIII.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
import scipy.sparse
from jaxtyping import Array, Float

from pinav.arguments import on_device
from pinav.dynamics import Swimmer
from pinav.fitting.matching.gauss_newton import Rates
from pinav.forces import ZeroForce
from pinav.trajectories import Trajectories, Trajectory, informative_rows

DEGREE = 7
"""Of the splines: exact states deserve more than a cubic."""

Table = Float[np.ndarray, "time channel"]
Curve = Callable[[Float[np.ndarray, " time"]], Table]


class PathSpline(NamedTuple):
    """A trajectory between its samples.

    Attributes:
        states: at any times between the first and the last.
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

    def through(kind: Callable[..., tuple[Curve, Curve]]) -> PathSpline:
        curve, rates = kind(times, states, DEGREE)
        _, others = kind(times, states, DEGREE - 2)
        return PathSpline(
            times, curve, rates, lambda t: np.linalg.norm(rates(t) - others(t), axis=1)
        )

    paths = map(through, kinds)
    return min(paths, key=lambda path: float(np.mean(path.doubts(times) ** 2)))


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
        [path.rates(path.times[:-1] + part * interval) for part in np.linspace(0, 1, 5)]
    )
    one, two = np.tensordot(SIMPSON, parts, axes=1)
    missed = interval[:, None] * np.abs(one - two)
    size = np.sqrt(np.mean(np.square(path.states(path.times)), axis=0))
    return float(np.max(missed / np.where(size > 0, size, np.inf)))


SIMPSON = np.array([[2, 0, 8, 0, 2], [1, 4, 2, 4, 1]]) / 12.0
"""Weights of Simpson's rule on one interval and on two."""


MOST_SAMPLES = 600
"""Samples that enter a regression, at most."""


def observed_rates(trajectories: Trajectories) -> Rates | None:
    """Rates at all complete samples and midway between them; None where too few are."""
    parts = []
    for path in path_splines(trajectories):
        middles = 0.5 * (path.times[:-1] + path.times[1:])
        times = np.insert(path.times, np.arange(1, len(path.times)), middles)
        rates = path.states(times), path.rates(times), path.doubts(times)
        parts.append(Rates(times, *rates))
    if not parts:
        return None
    return jax.tree.map(lambda *arrays: np.concatenate(arrays), *parts)


def path_splines(trajectories: Trajectories) -> list[PathSpline]:
    """The splines through all trajectories that have enough complete samples."""
    paths = (path_spline(one, trajectories.dim) for one in trajectories)
    return [path for path in paths if path is not None]


def thin_rates(rates: Rates, most: int) -> Rates:
    """The rates of the most informative samples: of states that differ, or their rates.

    Where a narrow force acts, rates change although states hardly do.
    """
    rows = informative_rows(np.hstack([rates.states, rates.rates]), most)
    return jax.tree.map(lambda array: array[rows], rates)


def residual_forces(swimmer: Swimmer, rates: Rates) -> Float[np.ndarray, "point dim"]:
    """The force at each sample that the known physics leave unexplained."""
    known = swimmer.with_environment(ZeroForce())
    explained = rates_of(known, rates.times, rates.states)
    return (rates.rates - explained)[:, rates.states.shape[1] // 2 :]


def rates_of(
    model: Any, times: Float[np.ndarray, " point"], states: Float[np.ndarray, "point n"]
) -> Float[np.ndarray, "point n"]:
    """Rates of change by a model."""
    with jax.enable_x64(new_val=True):
        return np.asarray(_all_rates(model, on_device(times), on_device(states)))


@eqx.filter_jit
def _all_rates(
    model: Any, times: Float[Array, " point"], states: Float[Array, "point n"]
) -> Float[Array, "point n"]:
    return jax.vmap(lambda t, y: model(t, y))(times, states)


class ForceSamples(NamedTuple):
    """Forces that the known physics leave unexplained, at samples of a regression.

    Attributes:
        places: all positions at which a force acts, which kernels surround [L].
        positions: those of the samples that enter the regression [L].
        forces: the forces there [L T⁻²].
    """

    places: Float[np.ndarray, "place dim"]
    positions: Float[np.ndarray, "point dim"]
    forces: Float[np.ndarray, "point dim"]

    @classmethod
    def of(cls, swimmer: Swimmer, rates: Rates) -> "ForceSamples":
        """The most informative samples at which splines agree on the force.

        Where they agree on less than half of them, all samples count.
        """
        forces = residual_forces(swimmer, rates)
        sizes = np.linalg.norm(forces, axis=1)
        acting = sizes >= LEAST_FORCE * sizes.max()
        if acting.sum() <= DEGREE:
            acting = np.ones_like(acting)
        known = np.ones_like(acting)
        if rates.doubts is not None:
            reliable = rates.doubts <= RELIABLE * sizes.max()
            known = reliable if reliable.mean() > MOSTLY else known
        parts = [np.flatnonzero(known & acting), np.flatnonzero(known & ~acting)]
        kept = np.concatenate(
            [rows[informative_rows(rates.states[rows], MOST_SAMPLES)] for rows in parts]
        )
        positions = rates.states[:, : forces.shape[1]]
        return cls(positions[acting], positions[kept], forces[kept])


RELIABLE, MOSTLY = 1e-3, 0.5
"""Doubts of a force that count as none, relative to the largest one; share of the
points above which the others are left out."""

LEAST_FORCE = 1e-7
"""Relative to the largest force: what acts less is left without kernels."""


class ForceRegion(NamedTuple):
    """Where the unknown force acts.

    Attributes:
        center: mean position, weighted by the magnitude of the force [L].
        radius: root-mean-square distance from it for each direction [L].
    """

    center: Float[np.ndarray, " dim"]
    radius: float


def force_region(
    rates: Rates, forces: Float[np.ndarray, "point dim"]
) -> ForceRegion | None:
    """Where the unknown force acts.

    A network whose positions are standardised by this region begins with a force that
    varies over the right distance, however far the swimmer coasts beyond it.

    Args:
        forces: there, that nothing known explains.

    Returns:
        The region; None where nothing acts.
    """
    positions = rates.states[:, : rates.states.shape[1] // 2]
    sizes = np.linalg.norm(forces, axis=1)
    spread = float(np.sqrt(positions.var(axis=0).mean()))
    if not (sizes.max() > ROUNDING * np.abs(rates.rates).max() and spread > 0):
        return None
    weights = sizes / sizes.sum()
    center = weights @ positions
    radius = float(np.sqrt((weights @ (positions - center) ** 2).mean()))
    return ForceRegion(center, max(radius, LEAST_RADIUS * spread))


def forces_beside_drag(
    velocities: Float[np.ndarray, "point dim"], forces: Float[np.ndarray, "point dim"]
) -> Float[np.ndarray, "point dim"]:
    """What a uniform force and a linear drag leave of forces.

    They are those of the least absolute misfit, by iterated weights, because a force
    that acts in few places must not bend them.

    Args:
        forces: all of them, or those that known physics leave [L T⁻²].
    """
    columns = np.insert(velocities, 0, 1.0, axis=1)
    left, weights = forces, np.ones((len(columns), 1))
    for _ in range(20):
        law, *_ = np.linalg.lstsq(weights * columns, weights * forces)
        left = forces - columns @ law
        sizes = np.linalg.norm(left, axis=1, keepdims=True)
        if not sizes.any():
            break
        # below a thousandth of the largest misfit weights no longer grow
        weights = 1.0 / np.sqrt(sizes + 1e-3 * sizes.max())
    return left


ROUNDING = 1e-12
"""Relative to the largest rate: no force that is told from rounding."""

LEAST_RADIUS = 0.02
"""Of a region where a force acts, in standard deviations of the positions."""


def substeps_for(
    trajectories: Trajectories, *, error: float = 1e-4, most: int = 8
) -> int:
    """Steps between two samples whose derivatives a fit can trust, a power of two.

    Args:
        error: relative, of a step of fourth order that is linearised.
        most: steps at most.
    """
    errors = [quadrature_error(path) for path in path_splines(trajectories)]
    finer = np.log2(max([*errors, error]) / error) / 4
    return min(2 ** int(np.ceil(finer)), most)
