"""Learned numbers of a swimmer and of its noise, in the units of a system."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.dynamics import OverdampedSwimmer
from pinav.fitting import Estimate, Posterior, ravel_model
from pinav.fitting.engine.parametric_model import selected_entries
from pinav.identification.models import CandidateModel
from pinav.systems import FreeNumber

PATHS = {
    "log_corner": "propulsion.response.corner",
    "logit_residual": "propulsion.response.residual",
    "delay": "propulsion.delay",
    "log_lag": "propulsion.lag",
}
"""Where the nonlinear parameters of the propulsion stand in a swimmer."""

BLOCK_NOISE = "noise of a block"
"""Name of the standard deviation of a block's mean position."""

NOISE_PATHS = {
    "log_still": "wandering.still",
    "log_driven": "wandering.driven",
    "log_memory": "wandering.memory",
    "log_slow": "wandering.slow",
    "log_slow_memory": "wandering.slow_memory",
    "log_gain_wander": "wander of the gain",
    "log_gain_memory": "memory of the gain",
    "log_noise": BLOCK_NOISE,
}
"""Names of the parameters of the noise among the constants of a fit."""

GAIN, DRIFT = "propulsion.gain", "flow.velocity"
"""Where the numbers stand in which displacements are linear."""

WEIGHTS = "environment"
"""Path of all weights of the environment."""


def natural(name: str, value: Float[Array, ""]) -> Float[Array, ""]:
    """A nonlinear parameter as a system states it, by its name in `NAMES`."""
    if name.startswith("log_"):
        return jnp.exp(value)
    return jax.nn.sigmoid(value) if name == "logit_residual" else value


class LearnedNumber(eqx.Module):
    """Learned numbers of a swimmer: a gain matrix, a delay, all weights.

    Attributes:
        path: where they stand, or the name of a parameter of the noise.
        values: flattened.
        slopes: derivatives by nonlinear parameters, present coefficients and weights.
    """

    path: str = eqx.field(static=True)
    values: Float[np.ndarray, " number"]
    slopes: Float[np.ndarray, "number unknown"]

    def label(self, index: int) -> str:
        """The path of one number: entries of a matrix or a vector by their place."""
        rows = {1: "", 2: f"[{index}]", 4: f"[{index // 2}, {index % 2}]"}
        return self.path + rows[len(self.values)]


def numbers_of(
    candidate: CandidateModel, unknown: Float[np.ndarray, " unknown"]
) -> list[LearnedNumber]:
    """Numbers of the swimmer.

    Args:
        candidate: what was learned.
        unknown: learned nonlinear parameters, present coefficients, and weights of an
            environment where there is one.
    """
    numbers = _nonlinear(candidate, unknown, PATHS)
    first = len(candidate.learned)
    linear = [(GAIN, np.reshape(candidate.gains, (-1, 4)))] if candidate.gains else []
    if candidate.drifts:
        linear.append((DRIFT, np.reshape(candidate.drifts, (-1, 2))))
    for path, basis in linear:
        slopes = np.zeros((basis.shape[1], len(unknown)))
        slopes[:, first : first + len(basis)] = basis.T
        numbers.append(LearnedNumber(path, slopes @ unknown, slopes))
        first += len(basis)
    if first < len(unknown):
        slopes = np.eye(len(unknown))[first:]
        numbers.append(LearnedNumber(WEIGHTS, unknown[first:], slopes))
    return numbers


def noise_of(
    candidate: CandidateModel, unknown: Float[np.ndarray, " unknown"]
) -> list[LearnedNumber]:
    """Numbers of the noise; arguments as of `numbers_of`."""
    return _nonlinear(candidate, unknown, NOISE_PATHS)


def _nonlinear(
    candidate: CandidateModel,
    unknown: Float[np.ndarray, " unknown"],
    paths: dict[str, str],
) -> list[LearnedNumber]:
    """Nonlinear parameters in the units of a system."""
    numbers = []
    for index, name in enumerate(candidate.learned):
        if name in paths:
            at = jnp.asarray(unknown[index])
            slopes = np.zeros((1, len(unknown)))
            slopes[0, index] = jax.grad(lambda value, name=name: natural(name, value))(
                at
            )
            value = np.asarray(natural(name, at)).reshape(1)
            numbers.append(LearnedNumber(paths[name], value, slopes))
    return numbers


def estimates_of(
    numbers: list[LearnedNumber], covariance: Float[np.ndarray, "unknown unknown"]
) -> dict[str, Estimate]:
    """Learned numbers by name, with their standard deviations; weights are left out."""
    estimates = {}
    for number in numbers:
        if number.path == WEIGHTS:
            continue
        spread = np.diag(number.slopes @ covariance @ number.slopes.T)
        deviations = np.sqrt(np.maximum(spread, 0.0))
        several = zip(number.values, deviations, strict=True)
        for index, (value, sd) in enumerate(several):
            estimates[number.label(index)] = Estimate(float(value), float(sd))
    return estimates


def posterior_over(
    swimmer: OverdampedSwimmer,
    numbers: list[LearnedNumber],
    covariance: Float[np.ndarray, "unknown unknown"],
) -> Posterior:
    """A posterior over numbers of a swimmer.

    Args:
        swimmer: the model.
        numbers: what is learned of it.
        covariance: of the unknowns by which the numbers have derivatives.
    """
    free_numbers = [FreeNumber(n.path) for n in numbers if n.path != WEIGHTS]
    has_weights = len(free_numbers) < len(numbers)

    def select(model: Any) -> tuple:
        weights = model.environment.parameters if has_weights else ()
        weights = weights if isinstance(weights, tuple) else (weights,)
        return *weights, *(number.pick(model) for number in free_numbers)

    exact = eqx.tree_at(select, swimmer, replace_fn=lambda x: jnp.asarray(x, float))
    free, theta = ravel_model(exact, select)
    places = [
        selected_entries(free, len(theta), FreeNumber(number.path).pick)
        for number in numbers
    ]
    order = np.concatenate([np.flatnonzero(chosen) for chosen in places])
    rows = np.concatenate([number.slopes for number in numbers])
    mean, full = np.array(theta), np.zeros((len(theta),) * 2)
    mean[order] = np.concatenate([number.values for number in numbers])
    full[np.ix_(order, order)] = rows @ covariance @ rows.T
    return Posterior(free, mean, full)
