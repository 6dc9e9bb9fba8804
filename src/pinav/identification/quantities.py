"""Quantities with a meaning that a fitted candidate gives, and their deviations."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.fitting import Estimate
from pinav.forces import heading_offset, mean_gain
from pinav.identification.models import CandidateModel, response_of


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
    with jax.enable_x64(new_val=True):
        values, slopes = _quantities_about(candidate, jnp.asarray(unknown))
    estimates = {}
    for name, value in values.items():
        slope = np.asarray(slopes[name])
        variance = max(float(slope @ covariance @ slope), 0.0)
        estimates[name] = Estimate(float(value), math.sqrt(variance))
    return estimates


@eqx.filter_jit
def _quantities_about(
    candidate: CandidateModel, unknown: Float[Array, " unknown"]
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Quantities with a meaning, and their derivatives."""

    def quantities(unknown: Array) -> dict[str, Array]:
        return _quantities(candidate, unknown)

    return quantities(unknown), jax.jacrev(quantities)(unknown)


def _quantities(
    candidate: CandidateModel, unknown: Array
) -> dict[str, Float[Array, ""]]:
    count = len(candidate.learned)
    matrices, velocities = (
        jnp.asarray(candidate.matrices()),
        jnp.asarray(candidate.velocities()),
    )
    quantities = {}
    if candidate.gains:
        gain = jnp.einsum("g,gab->ab", unknown[count : count + 4], matrices)
        quantities["gain"] = mean_gain(gain)
        quantities["gain x/y"] = jnp.linalg.norm(gain[0]) / jnp.linalg.norm(gain[1])
        quantities["heading offset"] = heading_offset(gain)
    if candidate.drifts:
        drift = unknown[count + 4 :] @ velocities
        quantities["drift x"], quantities["drift y"] = drift[0], drift[1]
    for index, name in enumerate(candidate.learned):
        value = unknown[index]
        if name.startswith("log_"):
            quantities[name.removeprefix("log_").replace("_", " ")] = jnp.exp(value)
        elif name == "logit_residual":
            quantities["residual"] = jax.nn.sigmoid(value)
        else:
            quantities[name] = value
    return quantities


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
        held: corner and residual gain where they were not learned.
        frequency: commanded.
    """
    with jax.enable_x64(new_val=True):
        places = map(jnp.asarray, (unknown, held, frequency))
        values, slopes = _speed_about(candidate, *places)
    slopes = np.asarray(slopes)
    variance = np.einsum("fp,pq,fq->f", slopes, covariance, slopes)
    return np.asarray(values), np.sqrt(np.maximum(variance, 0.0))


@eqx.filter_jit
def _speed_about(
    candidate: CandidateModel, unknown: Array, held: Array, frequency: Array
) -> tuple[Array, Array]:
    """Speed by frequency, and its derivative; what is not learned is held."""
    learned, matrices = candidate.learned, jnp.asarray(candidate.matrices())

    def law(unknown: Array) -> Array:
        values = dict(zip(learned, unknown[: len(learned)], strict=True))
        corner = values.get("log_corner", held[0])
        residual = values.get("logit_residual", held[1])
        gain = jnp.einsum(
            "g,gab->ab", unknown[len(learned) : len(learned) + 4], matrices
        )
        response = response_of(candidate.response, corner, residual)
        return mean_gain(gain) * response(frequency)

    return law(unknown), jax.jacrev(law)(unknown)
