"""The velocity over time that the propulsion of a candidate does not explain."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.identification.blocks_filter import rolling_about
from pinav.identification.fit import TrackFit
from pinav.identification.forecast import cycles
from pinav.identification.kalman import smoothed_velocity, transitions
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


def drift_over_time(track: Track, fit: TrackFit) -> DriftOverTime:
    """Smooth what gain and constant drift leave of a track.

    Args:
        track: its segments follow one another in the result.
        fit: a candidate of it.
    """
    parts = [_piece(piece, track.width, fit) for piece in track.pieces]
    return DriftOverTime(*map(np.concatenate, zip(*parts, strict=True)))


def _piece(piece: Trajectory, width: float, fit: TrackFit) -> tuple[np.ndarray, ...]:
    index = block_indices(piece.times, width)
    counts = np.bincount(index)

    def means(values: np.ndarray) -> np.ndarray:
        return np.bincount(index, values) / counts

    turned = cycles(fit, piece)
    left = piece.states - turned @ fit.gain.T
    left = left - np.outer(piece.times - piece.times[0], fit.drift)
    times = means(piece.times)
    frequency = means(commands_of(piece)[0])
    positions, along = (means(a) + 1j * means(b) for a, b in (left.T, turned.T))
    with jax.enable_x64(new_val=True):
        disturbance, rate = fit.disturbance, jnp.asarray(frequency)
        step_strength = disturbance.strength(rolling_about(rate))
        strength = disturbance.strength(rate)
        steps = transitions(
            jnp.asarray(np.diff(times)),
            step_strength,
            disturbance,
            jnp.asarray(np.diff(along)),
        )
        velocity, slow, sd = smoothed_velocity(
            jnp.asarray(positions), strength, steps, disturbance
        )
    velocities = np.asarray(velocity) + fit.drift, np.asarray(slow) + fit.drift
    return times, *velocities, np.asarray(sd)
