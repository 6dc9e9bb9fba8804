"""Forces along lines through the data, and along trajectories."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import on_device
from pinav.dynamics import Swimmer, with_dtype
from pinav.forces import AbstractForce, forces_at
from pinav.trajectories import Trajectories

ENDS = (0.01, 0.99)
"""Shares of the data between which a line runs."""

MOST_SAMPLES = 2000
"""Samples at most at which two forces are compared."""


class ForceLine(eqx.Module):
    """The component of a force along a line, over the place on it.

    Attributes:
        places: along the coordinate axis [L].
        force: component along that axis [F].
        sd: its standard deviation; None without a posterior.
        true: the true component, where it is known.
    """

    places: Float[np.ndarray, " place"]
    force: Float[np.ndarray, " place"]
    sd: Float[np.ndarray, " place"] | None = None
    true: Float[np.ndarray, " place"] | None = None


def line_through(
    positions: Float[np.ndarray, "sample dim"], axis: int, points: int = 60
) -> Float[np.ndarray, "point dim"]:
    """Points along one axis through the middle of the data.

    Args:
        positions: observed [L].
        axis: the coordinate that varies, over all but the last hundredths of the data.
        points: how many.
    """
    line = np.tile(np.median(positions, axis=0), (points, 1))
    low, high = np.quantile(positions[:, axis], ENDS)
    line[:, axis] = np.linspace(low, high, points)
    return line


def observed_positions(data: Trajectories) -> Float[np.ndarray, "sample dim"]:
    """All fully observed positions."""
    return data.positions[data.observed[..., : data.dim].all(axis=-1)]


def force_line(
    force: AbstractForce,
    data: Trajectories,
    axis: int,
    *,
    posterior: Any = None,
    truth: AbstractForce | None = None,
) -> ForceLine:
    """A force along one axis through the middle of the data, at time zero.

    Args:
        force: the field; evaluated in float64.
        data: around which the line lies.
        axis: the coordinate.
        posterior: of the force, for its standard deviation.
        truth: the true field, where it is known.
    """
    points = line_through(observed_positions(data), axis)
    return ForceLine(
        points[:, axis],
        _at(force, points)[:, axis],
        None if posterior is None else posterior.force_sd(points)[:, axis],
        None if truth is None else _at(truth, points)[:, axis],
    )


def force_error_at_samples(
    force: AbstractForce, truth: AbstractForce, data: Trajectories
) -> float:
    """Relative L2 error of a force at observed positions; those of many are thinned."""
    positions = observed_positions(data)
    positions = positions[:: max(len(positions) // MOST_SAMPLES, 1)]
    learned, true = _at(force, positions), _at(truth, positions)
    size = float(np.linalg.norm(true))
    return float(np.linalg.norm(learned - true)) / size if size > 0 else float("nan")


def _at(
    force: AbstractForce, points: Float[np.ndarray, "point dim"]
) -> Float[np.ndarray, "point dim"]:
    times = jnp.zeros(len(points))
    return np.asarray(forces_at(with_dtype(force, jnp.float64), times, points))


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
    terms = _terms(exact, on_device(times), on_device(states))
    return Decomposition(np.asarray(times), jax.tree.map(np.asarray, terms))


@eqx.filter_jit
def _terms(
    swimmer: Swimmer,
    times: Float[Array, " time"],
    states: Float[Array, "time state"],
) -> dict[str, Float[Array, "time dim"]]:
    """One compiled program in place of one for each operation."""
    x, v = jnp.split(states, 2, axis=1)
    forces = {
        "propulsion": swimmer.propulsion,
        "environment": swimmer.environment,
        "drag": swimmer.drag,
    }
    return {name: jax.vmap(force)(times, x, v) for name, force in forces.items()}
