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
from pinav.forces import UniformFlow, heading_offset, mean_gain
from pinav.identification.drive import drive_numbers, gain_of
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


def learned_posterior(
    swimmer: Swimmer | OverdampedSwimmer,
    learned: Sequence[Parameter],
    linear: dict[str, int],
    unknown: Float[np.ndarray, " unknown"],
    covariance: Float[np.ndarray, "unknown unknown"],
) -> tuple[Posterior, dict[str, Estimate]]:
    """Posterior of a swimmer, and the learned constants, those of the noise last.

    Args:
        linear: number of values of gain and drift, by their paths.
        unknown: coordinates of the nonlinear parameters, then gain, drift and weights.
    """
    values, slopes = unknown.copy(), np.ones(len(unknown))
    for place, parameter in enumerate(learned):
        values[place] = parameter.scale.number(unknown[place])
        slopes[place] = parameter.scale.slope(unknown[place])
    covariance = slopes[:, None] * covariance * slopes
    deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    paths = [parameter.path for parameter in learned]
    labels = [*paths]
    for path, count in linear.items():
        paths += [path] * count
        labels += [path + place for place in PLACES[count]]
    constants = {
        label: Estimate(float(value), float(sd))
        for label, value, sd in zip(labels, values, deviations, strict=False)
    }
    constants = dict(sorted(constants.items(), key=lambda one: one[0] in NOISE_PLACES))
    paths += [WEIGHTS] * (len(unknown) - len(paths))
    rows = np.flatnonzero([path not in NOISE_PLACES for path in paths])
    known = covariance[np.ix_(rows, rows)]
    return _posterior(swimmer, [paths[i] for i in rows], values[rows], known), constants


PLACES = {
    **{0: (), 1: ("",), 2: ("[0]", "[1]")},
    4: ("[0, 0]", "[0, 1]", "[1, 0]", "[1, 1]"),
}
"""Places of so many values: none, a number, a vector of the plane, or a matrix."""


def _posterior(
    swimmer: Swimmer | OverdampedSwimmer,
    paths: list[str],
    values: Float[np.ndarray, " number"],
    covariance: Float[np.ndarray, "number number"],
) -> Posterior:
    """The posterior of a swimmer whose numbers at these paths are learned."""
    numbers = [FreeNumber(path) for path in dict.fromkeys(paths)]

    def select(model: Any) -> tuple:
        weights = model.environment.parameters if WEIGHTS in paths else ()
        weights = weights if isinstance(weights, tuple) else (weights,)
        return *weights, *(n.pick(model) for n in numbers if n.path != WEIGHTS)

    exact = eqx.tree_at(select, swimmer, replace_fn=lambda x: jnp.asarray(x, float))
    free, theta = ravel_model(exact, select)
    chosen = [selected_entries(free, len(theta), number.pick) for number in numbers]
    order = np.concatenate(list(map(np.flatnonzero, chosen)))
    mean, full = np.array(theta), np.zeros((len(theta),) * 2)
    mean[order] = values
    full[np.ix_(order, order)] = covariance
    return Posterior(free, mean, full)


def entries(fit: EvidenceFit, path: str) -> Int[np.ndarray, " number"]:
    """Places of numbers of a swimmer among the parameters of its posterior."""
    posterior = fit.posterior
    pick = FreeNumber(path).pick
    return np.flatnonzero(selected_entries(posterior.free, len(posterior.mean), pick))


def drift_of(swimmer: OverdampedSwimmer) -> Float[np.ndarray, "2"]:
    """Drift of a swimmer [L T⁻¹]; zero without a uniform flow."""
    flow = swimmer.flow
    return np.asarray(flow.velocity) if isinstance(flow, UniformFlow) else np.zeros(2)


def estimates(fit: EvidenceFit) -> dict[str, Estimate]:
    """Quantities with a meaning, by name, with their standard deviations."""
    quantities: dict[str, Estimate] = {}
    if gain_of(fit.model) is not None:
        rows = zip(ABOUT_GAIN, derive(fit.posterior, _about_gain), strict=True)
        quantities |= {one.name: estimate for one, estimate in rows}
    several = [(f"{one.path}[{index}]", one.name) for index, one in enumerate(DRIFTS)]
    several += [(number.path, number.path) for number in drive_numbers(fit)]
    names, known = dict(several) | {p.path: p.name for p in PARAMETERS}, fit.constants
    return quantities | {names[path]: known[path] for path in names if path in known}


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
