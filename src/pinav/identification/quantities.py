"""Quantities with a meaning that a fitted candidate gives, and their deviations."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.fitting import Estimate
from pinav.forces import heading_offset, mean_gain
from pinav.identification.models import (
    RESPONSES,
    CandidateModel,
    SwitchedResponse,
)


def estimates_about(
    candidate: CandidateModel,
    unknown: Float[np.ndarray, " unknown"],
    covariance: Float[np.ndarray, "unknown unknown"],
) -> dict[str, Estimate]:
    """Quantities by name.

    Args:
        candidate: what was free.
        unknown: what was learned, then all coefficients.
        covariance: of these.
    """
    count, names = len(candidate.learned), _names(candidate)
    coefficients = unknown[count:]
    values, slopes = np.zeros(len(names)), np.zeros((len(names), len(unknown)))
    first = len(GAIN_QUANTITIES) if candidate.gains else 0
    if candidate.gains:
        matrices = candidate.matrices()
        gain = np.einsum("g,gab->ab", coefficients[:4], matrices)
        values[:first], by_entry = _about_gain(gain)
        slopes[:first, count : count + 4] = np.einsum("qab,gab->qg", by_entry, matrices)
    if candidate.drifts:
        velocities = candidate.velocities()
        values[first : first + 2] = coefficients[4:] @ velocities
        slopes[first : first + 2, count + 4 :] = velocities.T
    for index, name in enumerate(candidate.learned):
        place = len(names) - count + index
        values[place], slopes[place, index] = _about_parameter(name, unknown[index])
    variances = np.einsum("qp,pr,qr->q", slopes, covariance, slopes)
    sds = np.sqrt(np.maximum(variances, 0.0))
    return {
        name: Estimate(float(value), float(sd))
        for name, value, sd in zip(names, values, sds, strict=True)
    }


GAIN_QUANTITIES = ("gain", "gain x/y", "heading offset")
"""Numbers that a gain matrix gives."""


def _names(candidate: CandidateModel) -> list[str]:
    """Of the quantities of a candidate, in their order."""
    gains = GAIN_QUANTITIES if candidate.gains else ()
    drifts = ("drift x", "drift y") if candidate.drifts else ()
    return [*gains, *drifts, *map(_plain_name, candidate.learned)]


def _plain_name(name: str) -> str:
    """A learned parameter's name without its transformation."""
    if name == "logit_residual":
        return "residual"
    return name.removeprefix("log_").replace("_", " ")


def _about_parameter(name: str, value: float) -> tuple[float, float]:
    """The number that a parameter stands for, and its derivative."""
    if name.startswith("log_"):
        return math.exp(value), math.exp(value)
    if name == "logit_residual":
        part = 1 / (1 + math.exp(-value))
        return part, part * (1 - part)
    return value, 1.0


def _about_gain(
    gain: Float[np.ndarray, "2 2"],
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 2 2"]]:
    """`GAIN_QUANTITIES` and their derivatives by the entries."""
    with jax.enable_x64(new_val=True):
        values, slopes = _compiled_about_gain(jnp.asarray(gain))
    return np.asarray(values), np.asarray(slopes)


@jax.jit
def _compiled_about_gain(gain: Array) -> tuple[Array, Array]:
    """One program for all candidates: none is compiled for its name."""

    def quantities(gain: Array) -> Array:
        ratio = jnp.linalg.norm(gain[0]) / jnp.linalg.norm(gain[1])
        return jnp.stack([mean_gain(gain), ratio, heading_offset(gain)])

    return quantities(gain), jax.jacrev(quantities)(gain)


def speed_about(
    candidate: CandidateModel,
    unknown: Float[np.ndarray, " unknown"],
    covariance: Float[np.ndarray, "unknown unknown"],
    held: Float[np.ndarray, "2"],
    frequency: Float[np.ndarray, " place"],
) -> tuple[Float[np.ndarray, " place"], Float[np.ndarray, " place"]]:
    """Speed along the command by frequency [Hz], with its standard deviation.

    Args:
        candidate: what was free.
        unknown: what was learned, then all coefficients.
        covariance: of these.
        held: logarithm of the corner and logit of the residual gain.
        frequency: commanded.
    """
    count, matrices = len(candidate.learned), candidate.matrices()
    gain = np.einsum("g,gab->ab", unknown[count : count + 4], matrices)
    numbers, by_entry = _about_gain(gain)
    response, by_drive = _about_response(candidate.response, held, frequency)
    slopes = np.zeros((len(frequency), len(unknown)))
    by_gain = np.einsum("ab,gab->g", by_entry[0], matrices)
    slopes[:, count : count + 4] = response[:, None] * by_gain
    for column, name in enumerate(("log_corner", "logit_residual")):
        if name in candidate.learned:
            place = candidate.learned.index(name)
            slopes[:, place] = numbers[0] * by_drive[:, column]
    variance = np.einsum("fp,pq,fq->f", slopes, covariance, slopes)
    return numbers[0] * response, np.sqrt(np.maximum(variance, 0.0))


def _about_response(
    name: str, drive: Float[np.ndarray, "2"], frequency: Float[np.ndarray, " place"]
) -> tuple[Float[np.ndarray, " place"], Float[np.ndarray, "place 2"]]:
    """A response and its derivatives by log corner and logit residual."""
    with jax.enable_x64(new_val=True):
        index = jnp.asarray(RESPONSES.index(name))
        places = jnp.asarray(drive), jnp.asarray(frequency)
        values, slopes = _compiled_about_response(index, *places)
    return np.asarray(values), np.asarray(slopes)


@jax.jit
def _compiled_about_response(
    index: Array, drive: Array, frequency: Array
) -> tuple[Array, Array]:
    def law(drive: Array) -> Array:
        return SwitchedResponse(index, drive[0], drive[1])(frequency)

    return law(drive), jax.jacfwd(law)(drive)
