"""Numbers of a fitted swimmer: of its constants, and with a meaning of their own."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.fitting import Estimate, EvidenceFit, Posterior, ravel_model
from pinav.fitting.engine.parametric_model import selected_entries
from pinav.forces import (
    RollingPropulsion,
    UniformFlow,
    heading_offset,
    mean_gain,
)
from pinav.identification.candidates import (
    SwitchedResponse,
    gain_basis,
    response_place,
)
from pinav.identification.parameters import (
    CORNER,
    DRIFT,
    DRIVE,
    GAIN,
    PARAMETERS,
    PLACES,
    RESIDUAL,
    Parameter,
    drive_coordinates,
)
from pinav.systems import FreeNumber

WEIGHTS = "environment"
"""Path of all weights of the environment."""


class LearnedNumber(eqx.Module):
    """Learned numbers of a swimmer: a gain matrix, a delay, all weights.

    Attributes:
        path: where they stand, or the name of a parameter of the noise.
        values: the numbers, flattened.
        slopes: derivatives by nonlinear parameters, coefficients and weights.
    """

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
    """All learned numbers: of the drive, gain, drift, environment, and the noise.

    Args:
        learned: nonlinear parameters.
        linear: how many numbers there are of gain and drift, by their paths.
        unknown: coordinates of the nonlinear parameters, then gain, drift, and weights
            of an environment where there is one.
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
    return PLACES.get(number.path, 0) >= len(DRIVE)


def constants_of(
    numbers: list[LearnedNumber], covariance: Float[np.ndarray, "unknown unknown"]
) -> dict[str, Estimate]:
    """Learned numbers by name, with their standard deviations; weights are left out.

    Those of the noise come last.
    """
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
    """The posterior of a swimmer whose learned numbers have these values.

    Args:
        swimmer: the numbers that are not learned are right.
        numbers: all learned ones; those of the noise are no part of it.
        covariance: of the unknowns by which the numbers have derivatives.
    """
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
    found: dict[str, Estimate] = {}
    if isinstance(fit.model.propulsion, RollingPropulsion):
        values, slopes = _about_gain(fit)
        covariance = fit.posterior.covariance
        places = entries(fit, GAIN)
        spread = slopes @ covariance[np.ix_(places, places)] @ slopes.T
        deviations = np.sqrt(np.maximum(np.diag(spread), 0.0))
        rows = zip(GAIN_QUANTITIES, values, deviations, strict=True)
        found |= {name: Estimate(float(v), float(sd)) for name, v, sd in rows}
    for index, axis in enumerate("xy"):
        drift = fit.constants.get(f"{DRIFT}[{index}]")
        found |= {} if drift is None else {f"drift {axis}": drift}
    for parameter in PARAMETERS:
        if parameter.path in fit.constants:
            found[parameter.name] = fit.constants[parameter.path]
    return found


GAIN_QUANTITIES = ("gain", "gain x/y", "heading offset")
"""Numbers that a gain matrix gives."""


def _about_gain(
    fit: EvidenceFit,
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 number"]]:
    """`GAIN_QUANTITIES` and their derivatives by the numbers of the gain."""
    basis = gain_basis(np.ndim(fit.model.propulsion.gain))
    with jax.enable_x64(new_val=True):
        values, slopes = _compiled_about_gain(jnp.asarray(gain_of(fit.model)))
    return np.asarray(values), np.einsum("qab,gab->qg", np.asarray(slopes), basis)


@jax.jit
def _compiled_about_gain(gain: Array) -> tuple[Array, Array]:
    """One program for all candidates: none is compiled for its name."""

    def quantities(gain: Array) -> Array:
        ratio = jnp.linalg.norm(gain[0]) / jnp.linalg.norm(gain[1])
        return jnp.stack([mean_gain(gain), ratio, heading_offset(gain)])

    return quantities(gain), jax.jacrev(quantities)(gain)


def speed(
    fit: EvidenceFit, frequency: Float[np.ndarray, " place"]
) -> tuple[Float[np.ndarray, " place"], Float[np.ndarray, " place"]]:
    """Speed along the command by frequency [Hz], with its standard deviation."""
    values, by_gain = _about_gain(fit)
    response, by_drive = _about_response(fit.model, frequency)
    places, columns = [entries(fit, GAIN)], [response[:, None] * by_gain[0]]
    for column, path in enumerate((CORNER, RESIDUAL)):
        if path in fit.constants:
            parameter = DRIVE[PLACES[path]]
            at = drive_coordinates(fit.model)[PLACES[path]]
            by_number = by_drive[:, column] / parameter.scale.slope(at)
            places.append(entries(fit, path))
            columns.append(values[0] * by_number[:, None])
    slopes, several = np.concatenate(columns, axis=1), np.concatenate(places)
    covariance = fit.posterior.covariance[np.ix_(several, several)]
    variance = np.einsum("fp,pq,fq->f", slopes, covariance, slopes)
    return values[0] * response, np.sqrt(np.maximum(variance, 0.0))


def _about_response(
    swimmer: OverdampedSwimmer, frequency: Float[np.ndarray, " place"]
) -> tuple[Float[np.ndarray, " place"], Float[np.ndarray, "place 2"]]:
    """A response and its derivatives by log corner and logit residual."""
    with jax.enable_x64(new_val=True):
        index = jnp.asarray(response_place(swimmer))
        drive = drive_coordinates(swimmer)[:2]
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
