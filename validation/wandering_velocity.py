"""The velocity over time that the propulsion of a candidate does not explain."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from pinav.fitting import EvidenceFit
from pinav.identification.estimates import drift_of
from pinav.identification.forecast import DrivenSwimmer
from pinav.identification.kalman import (
    Disturbance,
    State,
    Transition,
    begin,
    predict,
    transitions,
    update,
)
from pinav.identification.likelihood import disturbance_of, rolling_about
from pinav.identification.parameters import fitted_coordinates
from pinav.identification.tracks import Track, block_indices, commands_of
from pinav.trajectories import Trajectory


class DriftOverTime(eqx.Module):
    """Drift and disturbance of a track together, given all of its positions.

    Attributes:
        times: middle of each block [T].
        velocity: constant drift plus all that wanders [L T⁻¹].
        drift: constant drift plus what changes slowly [L T⁻¹].
        sd: standard deviation of the velocity along either axis, parameters known.
    """

    times: Float[np.ndarray, " block"]
    velocity: Float[np.ndarray, "block 2"]
    drift: Float[np.ndarray, "block 2"]
    sd: Float[np.ndarray, " block"]


def drift_over_time(track: Track, fit: EvidenceFit) -> DriftOverTime:
    """Smooth what gain and constant drift leave of a track.

    Args:
        track: its segments follow one another in the result.
        fit: a candidate of it.
    """
    parts = [_piece(piece, track.width, fit) for piece in track.pieces]
    return DriftOverTime(*map(np.concatenate, zip(*parts, strict=True)))


def _piece(piece: Trajectory, width: float, fit: EvidenceFit) -> tuple[np.ndarray, ...]:
    index = block_indices(piece.times, width)
    counts = np.bincount(index)

    def means(values: np.ndarray) -> np.ndarray:
        return np.bincount(index, values) / counts

    driven, swimmer = DrivenSwimmer.of(fit.model), fit.model
    turned, left = driven.displacements(piece), piece.states - driven.path(piece)
    times = means(piece.times)
    frequency = means(commands_of(piece)[0])
    positions, along = (means(a) + 1j * means(b) for a, b in (left.T, turned.T))
    with jax.enable_x64(new_val=True):
        coordinates = jnp.asarray(fitted_coordinates(fit))
        disturbance, rate = disturbance_of(coordinates), jnp.asarray(frequency)
        step_strength = disturbance.wandering.strength(rolling_about(rate))
        strength = disturbance.wandering.strength(rate)
        steps = transitions(
            jnp.asarray(np.diff(times)),
            step_strength,
            disturbance,
            jnp.asarray(np.diff(along)),
        )
        velocity, slow, sd = smoothed_velocity(
            jnp.asarray(positions), strength, steps, disturbance
        )
    velocities = (np.asarray(part) + drift_of(swimmer) for part in (velocity, slow))
    return times, *velocities, np.asarray(sd)


def smoothed_velocity(
    positions: Complex[Array, " block"],
    strength: Float[Array, " block"],
    transition: Transition,
    disturbance: Disturbance,
) -> tuple[Float[Array, "block 2"], Float[Array, "block 2"], Float[Array, " block"]]:
    """Velocity of both processes at each block.

    Args:
        positions: what the regressors leave [L], x + iy.
        strength: of the quick velocity at each block.
        transition: from each block to the next.
        disturbance: slow velocity and noise.

    Returns:
        Mean velocity [L T⁻¹] of both processes together, that of the slow one alone,
        and the standard deviation of both together along either axis.

    References:
        Rauch, Tung and Striebel, AIAA J. 3, 1445 (1965).
    """
    noise, rows = disturbance.noise, positions[:, None]
    start = begin(rows[0], noise)

    def forth(state: State, inputs: tuple[Array, ...]) -> tuple[State, tuple]:
        matrix, added, row = inputs
        ahead = predict(state, matrix, added)
        _, _, updated = update(ahead, row, noise)
        return updated, (state, ahead)

    def back(later: State, inputs: tuple) -> tuple[State, State]:
        mean, covariance = later
        (past_mean, past_spread), (ahead_mean, ahead_spread), matrix = inputs
        # P A' Q^-1 as the adjoint of Q^-1 A P, since both covariances are Hermitian.
        gain = jnp.linalg.solve(ahead_spread, matrix @ past_spread).conj().T
        mean = past_mean + gain @ (mean - ahead_mean)
        covariance = past_spread + gain @ (covariance - ahead_spread) @ gain.conj().T
        return (mean, covariance), (mean, covariance)

    inputs = transition.matrix, transition.noise, rows[1:]
    last, (states, ahead) = jax.lax.scan(forth, start, inputs)
    passed = states, ahead, transition.matrix
    _, (means, spreads) = jax.lax.scan(back, last, passed, reverse=True)
    means = jnp.concatenate([means, last[0][None]])
    spreads = jnp.concatenate([spreads, last[1][None]])
    slow = jnp.broadcast_to(disturbance.wandering.slow, strength.shape)
    nothing = jnp.zeros_like(strength)
    weights = jnp.stack([nothing, strength, slow, nothing], axis=1)
    means = jnp.stack([means[..., 0].real, means[..., 0].imag], axis=-1)
    both = jnp.einsum("bs,bsa->ba", weights, means)
    alone = slow[:, None] * means[:, 2]
    variance = jnp.einsum("bs,bst,bt->b", weights, spreads.real, weights)
    return both, alone, jnp.sqrt(variance)
