"""Numbers of a fitted swimmer: of its constants, and with a meaning of their own."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.fitting import Estimate, EvidenceFit, Posterior, ravel_model
from pinav.fitting.bayes.parameters import derive
from pinav.fitting.engine.local_model import selected_entries
from pinav.forces import RollingPropulsion, UniformFlow, heading_offset, mean_gain
from pinav.identification.parameters import (
    ABOUT_GAIN,
    DRIFTS,
    NOISE_PLACES,
    PARAMETERS,
    Parameter,
)
from pinav.systems import FreeNumber

WEIGHTS = "environment"
"""Path of all weights of the environment."""


class LearnedNumber(eqx.Module):
    """Flattened numbers of a swimmer or its noise, and slopes by all unknowns."""

    path: str = eqx.field(static=True)
    values: Float[np.ndarray, " number"]
    slopes: Float[np.ndarray, "number unknown"]

    def label(self, index: int) -> str:
        """The path of one number: entries of a matrix or a vector by their place."""
        rows = {1: "", 2: f"[{index}]", 4: f"[{index // 2}, {index % 2}]"}
        return self.path + rows[len(self.values)]


def learned_numbers(
    learned: Sequence[Parameter],
    linear: dict[str, int],
    unknown: Float[np.ndarray, " unknown"],
) -> list[LearnedNumber]:
    """All learned numbers: of drive, gain, drift, environment and noise.

    Args:
        linear: number of values of gain and drift, by their paths.
        unknown: coordinates of the nonlinear parameters, then gain, drift and weights.
    """
    identity, numbers = np.eye(len(unknown)), []
    for row, parameter, at in zip(identity, learned, unknown, strict=False):
        slopes = parameter.scale.slope(at) * row[None]
        value = np.array([parameter.scale.number(at)])
        numbers.append(LearnedNumber(parameter.path, value, slopes))
    first = len(learned)
    rest = len(unknown) - first - sum(linear.values())
    for path, count in {**linear, WEIGHTS: rest}.items():
        if count:
            rows = slice(first, first + count)
            numbers.append(LearnedNumber(path, unknown[rows], identity[rows]))
            first += count
    return numbers


def is_noise(number: LearnedNumber) -> bool:
    """True of a number that stands in no swimmer."""
    return number.path in NOISE_PLACES


def constants_of(
    numbers: list[LearnedNumber], covariance: Float[np.ndarray, "unknown unknown"]
) -> dict[str, Estimate]:
    """Learned constants with standard deviations; those of the noise come last."""
    estimates = {}
    for number in sorted(numbers, key=is_noise):
        if number.path == WEIGHTS:
            continue
        spread = np.diag(number.slopes @ covariance @ number.slopes.T)
        deviations = np.sqrt(np.maximum(spread, 0.0))
        several = zip(number.values, deviations, strict=True)
        for index, (value, sd) in enumerate(several):
            estimates[number.label(index)] = Estimate(float(value), float(sd))
    return estimates


def posterior_over(
    swimmer: Swimmer | OverdampedSwimmer,
    numbers: list[LearnedNumber],
    covariance: Float[np.ndarray, "unknown unknown"],
) -> Posterior:
    """The posterior of a swimmer whose learned numbers have these values."""
    numbers = [number for number in numbers if not is_noise(number)]
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


def entries(fit: EvidenceFit, path: str) -> Int[np.ndarray, " number"]:
    """Places of numbers of a swimmer among the parameters of its posterior."""
    posterior = fit.posterior
    pick = FreeNumber(path).pick
    return np.flatnonzero(selected_entries(posterior.free, len(posterior.mean), pick))


def gain_of(swimmer: OverdampedSwimmer) -> Float[np.ndarray, "2 2"]:
    """Gain matrix of a swimmer [L per cycle]; zero without a propulsion."""
    propulsion = swimmer.propulsion
    if not isinstance(propulsion, RollingPropulsion):
        return np.zeros((2, 2))
    return np.asarray(propulsion.matrix, float)


def drift_of(swimmer: OverdampedSwimmer) -> Float[np.ndarray, "2"]:
    """Drift of a swimmer [L T⁻¹]; zero without a uniform flow."""
    flow = swimmer.flow
    return np.asarray(flow.velocity) if isinstance(flow, UniformFlow) else np.zeros(2)


def estimates(fit: EvidenceFit) -> dict[str, Estimate]:
    """Quantities with a meaning, by name, with their standard deviations."""
    quantities: dict[str, Estimate] = {}
    if isinstance(fit.model.propulsion, RollingPropulsion):
        rows = zip(ABOUT_GAIN, derive(fit.posterior, _about_gain), strict=True)
        quantities |= {one.name: estimate for one, estimate in rows}
    several = [(f"{one.path}[{index}]", one.name) for index, one in enumerate(DRIFTS)]
    several += [(parameter.path, parameter.name) for parameter in PARAMETERS]
    known = fit.constants
    return quantities | {name: known[path] for path, name in several if path in known}


def _about_gain(swimmer: OverdampedSwimmer) -> Float[Array, "3"]:
    propulsion: Any = swimmer.propulsion
    gain = propulsion.matrix
    ratio = jnp.linalg.norm(gain[0]) / jnp.linalg.norm(gain[1])
    return jnp.stack([mean_gain(gain), ratio, heading_offset(gain)])


def speeds(fit: EvidenceFit, frequency: Float[np.ndarray, " place"]) -> list[Estimate]:
    """Speed along the command at each frequency [Hz]."""

    def law(swimmer: OverdampedSwimmer) -> Float[Array, " place"]:
        propulsion: Any = swimmer.propulsion
        return _about_gain(swimmer)[0] * propulsion.response(jnp.asarray(frequency))

    return derive(fit.posterior, law)
