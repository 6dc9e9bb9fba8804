"""The filter on the blocks of a track: the noise that moves with the drive."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float

from pinav.identification.kalman import (
    Disturbance,
    Innovations,
    Transition,
    innovations,
    transitions,
)
from pinav.identification.parameters import BLOCK_NOISE, PLACES


def disturbance_of(theta: Float[Array, " parameter"]) -> Disturbance:
    """The noise at these coordinates."""
    number = {path: jnp.exp(theta[place]) for path, place in PLACES.items()}
    return Disturbance(
        still=number["wandering.still"],
        driven=number["wandering.driven"],
        memory=number["wandering.memory"],
        slow=number["wandering.slow"],
        slow_memory=number["wandering.slow_memory"],
        gain_wander=number["wander of the gain"],
        gain_memory=number["memory of the gain"],
        noise=number[BLOCK_NOISE],
    )


def in_plane(vectors: Float[Array, "*shape 2"]) -> Complex[Array, "*shape"]:
    """Vectors of the plane as complex numbers."""
    return jax.lax.complex(vectors[..., 0], vectors[..., 1])


def apart(points: Complex[Array, " row *column"]) -> Float[Array, " twice *column"]:
    """Complex numbers as real ones: x of all, and then y of all."""
    return jnp.concatenate([points.real, points.imag])


class Drive(eqx.Module):
    """What moves the blocks of a track, as far as the noise depends on it.

    Attributes:
        times: mean of each block [T].
        frequency: commanded [T⁻¹].
        cycles: integral of the response along the heading, x + iy.
    """

    times: Float[Array, " block"]
    frequency: Float[Array, " block"]
    cycles: Complex[Array, " block"]


def innovations_of_columns(
    theta: Array, columns: Array, drive: Drive, blocks: Any
) -> Innovations:
    """Innovations of columns given at each block, x + iy."""
    disturbance = disturbance_of(theta)
    present = (blocks.counts > 0).astype(drive.times.dtype)
    transition = transitions_of(disturbance, drive, steps_within(blocks))
    return innovations(columns, present, blocks.begins, transition, disturbance.noise)


def transitions_of(
    disturbance: Disturbance, drive: Drive, within: Float[Array, " step"]
) -> Transition:
    """From each block to the next; `within` is 1 for the steps within a segment."""
    # Between segments any positive step does: the filter begins anew there.
    steps = jnp.where(within > 0, jnp.diff(drive.times), 1.0)
    strength = disturbance.strength(rolling_about(drive.frequency))
    return transitions(steps, strength, disturbance, jnp.diff(drive.cycles))


def steps_within(blocks: Any) -> Float[Array, " step"]:
    """1 for each step within a segment of `Blocks`."""
    present = (blocks.counts[1:] > 0).astype(blocks.counts.dtype)
    return present * (1 - blocks.begins[1:])


def rolling_about(frequency: Float[Array, " block"]) -> Float[Array, " step"]:
    """Highest frequency from one block before each step to one block after it.

    When a robot starts or stops it does so within a delay that the logs do not fix; a
    disturbance as small as at rest would make that moment the most exact of data.
    """
    padded = jnp.concatenate([frequency[:1], frequency, frequency[-1:]])
    later = padded[1:], padded[2:], padded[3:]
    steps = frequency.shape[0] - 1
    highest = padded[:steps]
    for shifted in later:
        highest = jnp.maximum(highest, shifted[:steps])
    return highest
