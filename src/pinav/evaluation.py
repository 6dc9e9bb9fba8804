"""Scores of a model: rollout errors, and the force on visited ground.

Every rollout is solved anew in float64 at a tight tolerance, whatever the fit
used, so that a fit cannot profit from the errors of its own integrator.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from pinav.dynamics import AbstractDynamics, Outcome, Swimmer, rollout, with_dtype
from pinav.errors import InputError
from pinav.forces import AbstractForce
from pinav.solvers import AbstractSolver, Adaptive
from pinav.trajectories import Trajectories

POSITION_CHANNELS = ("x", "y", "z")


class Score(eqx.Module):
    """Root-mean-square errors of rollouts against observed states.

    Attributes:
        channels: names of the components of the state.
        rmse: error of each component, over all observed samples.
        outcomes: how the rollout of each trajectory ended.
    """

    channels: tuple[str, ...] = eqx.field(static=True)
    rmse: Float[np.ndarray, " state"]
    outcomes: tuple[Outcome, ...] = eqx.field(static=True)

    @property
    def total(self) -> float:
        """Root mean square of the errors of all components (paper, Table 2)."""
        return float(np.sqrt(np.mean(self.rmse**2)))

    @property
    def position(self) -> float:
        """Root mean square of the errors of the position components alone."""
        chosen = [name in POSITION_CHANNELS for name in self.channels]
        return float(np.sqrt(np.mean(self.rmse[chosen] ** 2)))


def predict(
    dynamics: AbstractDynamics,
    trajectories: Trajectories,
    *,
    starts: Float[np.ndarray, "trajectory state"] | None = None,
    solver: AbstractSolver | None = None,
) -> tuple[Float[np.ndarray, "trajectory time state"], tuple[Outcome, ...]]:
    """Rollouts over the times of each trajectory, in float64.

    Args:
        dynamics: the model, in any precision; it is cast exactly.
        trajectories: when to save.
        starts: first state of each rollout; the first sample unless given.
        solver: how to integrate; `Adaptive()` (Dopri8 at 1e-11) unless given.

    Returns:
        The states, and how each rollout ended: a diverged one is data, not an error.

    Raises:
        InputError: a first sample is not fully observed, or x64 is switched off.
    """
    require_x64("scoring")
    starts = _first_samples(trajectories) if starts is None else starts
    first = jnp.asarray(starts, jnp.float64)
    times = jnp.asarray(trajectories.times, jnp.float64)
    solver = Adaptive() if solver is None else solver
    ys, outcomes = _rollouts(with_dtype(dynamics, jnp.float64), first, times, solver)
    return np.asarray(ys), tuple(Outcome(int(code)) for code in outcomes)


def _first_samples(trajectories: Trajectories):
    for index, first in enumerate(trajectories.observed[:, 0]):
        if not first.all():
            raise InputError(
                f"trajectory {index}: its first sample is not fully observed, so no "
                "rollout can start there; drop the samples before a complete one"
            )
    return trajectories.states[:, 0]


@eqx.filter_jit
def _rollouts(dynamics, starts, times, solver):
    def one(y0, ts):
        solution = rollout(dynamics, y0, ts, solver=solver, throw=False)
        return solution.ys, solution.outcome

    return jax.vmap(one)(starts, times)


def score(
    predictions: Float[np.ndarray, "trajectory time state"],
    outcomes: tuple[Outcome, ...],
    trajectories: Trajectories,
) -> Score:
    """Errors of `predictions` over every observed entry of `trajectories`.

    A diverged rollout scores infinity.
    """
    observed = trajectories.observed
    squares = np.where(observed, (predictions - trajectories.states) ** 2, 0.0)
    squares = np.where(np.isfinite(squares), squares, np.inf)
    mean = squares.sum(axis=(0, 1)) / observed.sum(axis=(0, 1))
    return Score(trajectories.channels, np.sqrt(mean), outcomes)


def require_x64(purpose: str) -> None:
    """Raise `InputError` where JAX would silently compute in float32."""
    if not jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        raise InputError(
            f"{purpose} needs float64: call "
            'jax.config.update("jax_enable_x64", True) before anything else'
        )


class FieldMap(eqx.Module):
    """A planar force field on a grid, and how far its points are from the data.

    Attributes:
        x: grid coordinates along x [L].
        y: grid coordinates along y [L].
        force: force at each grid point [L T⁻²].
        distance: distance of each grid point to the nearest sample [L].
    """

    x: Float[np.ndarray, " columns"]
    y: Float[np.ndarray, " rows"]
    force: Float[np.ndarray, "rows columns 2"]
    distance: Float[np.ndarray, "rows columns"]


VISITED, NEAR = 0.35, 1.0
"""Grid points this close to a sample [L] are called visited, and near."""


def field_map(
    force: AbstractForce,
    trajectories: Trajectories,
    *,
    time: float | None = None,
    limits: tuple[float, float, float, float] | None = None,
    points: int = 57,
) -> FieldMap:
    """The force of a swimmer at rest at each point of a planar grid.

    Args:
        force: the field; evaluated in float64.
        trajectories: their observed positions define the distance.
        time: time [T] at which a field that depends on it is drawn; unless given,
            each grid point takes the time of its nearest sample, the reading most
            favourable to such a field.
        limits: x from, x to, y from, y to [L]; a square around the data unless given.
        points: grid points along each side.
    """
    x_from, x_to, y_from, y_to = _square(trajectories) if limits is None else limits
    x, y = np.linspace(x_from, x_to, points), np.linspace(y_from, y_to, points)
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    flat = grid.reshape(-1, 2)
    distance, nearest_times = _nearest_samples(flat, trajectories)
    ts = nearest_times if time is None else np.full_like(nearest_times, time)
    exact = with_dtype(force, jnp.float64)
    at_rest = jax.vmap(lambda t, x: exact(t, x, jnp.zeros_like(x)))
    values = at_rest(jnp.asarray(ts), jnp.asarray(flat))
    return FieldMap(
        x, y, np.asarray(values).reshape(grid.shape), distance.reshape(grid.shape[:2])
    )


def _square(trajectories):
    """The smallest square around the observed positions, with a margin of `NEAR`."""
    samples = _observed_positions(trajectories)[0]
    low, high = samples.min(axis=0), samples.max(axis=0)
    middle, half = (low + high) / 2, (high - low).max() / 2 + NEAR
    return middle[0] - half, middle[0] + half, middle[1] - half, middle[1] + half


def _observed_positions(trajectories):
    """All fully observed planar positions, and their times."""
    seen = trajectories.observed[..., :2].all(-1)
    return trajectories.states[..., :2][seen], trajectories.times[seen]


def _nearest_samples(points, trajectories):
    """Distance to, and time of, the nearest fully observed position."""
    from scipy.spatial import KDTree

    samples, times = _observed_positions(trajectories)
    distance, index = KDTree(samples).query(points)
    return distance, times[index]


def force_error(
    learned: FieldMap, true: FieldMap, region: Bool[np.ndarray, "rows columns"]
) -> float:
    r"""Relative error $\|F - F^*\|_2 / \|F^*\|_2$ over the grid points of a region."""
    difference = (learned.force - true.force)[region]
    return float(np.linalg.norm(difference) / np.linalg.norm(true.force[region]))


def force_errors(learned: FieldMap, true: FieldMap) -> dict[str, float]:
    """Relative L2 force error on visited ground, near it, and on the whole grid."""
    regions = {
        "visited": true.distance <= VISITED,
        "near": true.distance <= NEAR,
        "everywhere": np.ones_like(true.distance, bool),
    }
    return {name: force_error(learned, true, mask) for name, mask in regions.items()}


class Decomposition(eqx.Module):
    """What makes up the acceleration along a trajectory.

    Attributes:
        times: times [T].
        terms: propulsion, environment and drag at each time [L T⁻²].
    """

    times: Float[np.ndarray, " time"]
    terms: dict[str, Float[np.ndarray, "time dim"]]


def decompose(
    swimmer: Swimmer,
    times: Float[np.ndarray, " time"],
    states: Float[np.ndarray, "time state"],
) -> Decomposition:
    """Split a(t) = propulsion + environment + drag along given states.

    References:
        PI-NAV paper, addendum 3 (structural interpretability).
    """
    exact = with_dtype(swimmer, jnp.float64)
    x, v = jnp.split(jnp.asarray(states), 2, axis=1)
    forces = {
        "propulsion": exact.propulsion,
        "environment": exact.environment,
        "drag": exact.drag,
    }
    ts = jnp.asarray(times)
    terms = {k: np.asarray(jax.vmap(f)(ts, x, v)) for k, f in forces.items()}
    return Decomposition(np.asarray(times), terms)
