"""A fitted response as a system, and a system as a candidate model."""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.actuation import (
    AbstractResponse,
    LinearResponse,
    SaturatingResponse,
    SlippingResponse,
    StepOutResponse,
)
from pinav.dynamics import OverdampedSwimmer
from pinav.errors import InputError
from pinav.fitting import (
    Estimate,
    EvidenceFit,
    Hyperparameters,
    LinearFit,
    Outcome,
    ParametricModel,
    Posterior,
    ravel_model,
)
from pinav.fitting.engine.parametric_model import selected_entries
from pinav.fitting.evidence.quadratic import Quadratic
from pinav.fitting.evidence.weights import NoWeights
from pinav.forces import (
    RollingPropulsion,
    UniformFlow,
    ZeroForce,
)
from pinav.identification.fit import TrackFit
from pinav.identification.likelihood import Prior
from pinav.identification.models import (
    ABSENT,
    BOTH,
    CORNERS,
    FULL,
    NAMES,
    SLOW_DRIFT,
    CandidateModel,
    response_of,
)
from pinav.systems import (
    Flat,
    FreeNumber,
    LogNormal,
    Normal,
    Observation,
    System,
    Units,
    WanderingVelocity,
)

PATHS = {
    "log_corner": "propulsion.response.corner",
    "logit_residual": "propulsion.response.residual",
    "delay": "propulsion.delay",
    "log_lag": "propulsion.lag",
}
"""Where the nonlinear parameters of the propulsion stand in a swimmer."""

GAIN, DRIFT = "propulsion.gain", "flow.velocity"
"""Where the numbers stand in which displacements are linear."""

RESPONSE_NAMES: dict[type[AbstractResponse], str] = {
    LinearResponse: "linear",
    SaturatingResponse: "saturating",
    SlippingResponse: "slipping",
    StepOutResponse: "step-out",
}
"""Name of each response among the candidate models."""


def natural(name: str, value: Float[Array, ""]) -> Float[Array, ""]:
    """A nonlinear parameter as a system states it, by its name in `NAMES`."""
    if name.startswith("log_"):
        return jnp.exp(value)
    return jax.nn.sigmoid(value) if name == "logit_residual" else value


def system_of(
    fit: TrackFit, *, jitter: float, name: str, units: dict[str, str]
) -> System:
    """The system that a fitted candidate describes.

    Its environment is unknown. What was learned may be learned again: gain and drift
    with flat priors, delay, corner and residual gain with what the fit says of them.

    Args:
        fit: a candidate on a track.
        jitter: standard deviation of single frames about the mean path [L].
        name: of the system.
        units: of the recording.
    """
    disturbance = {
        key: float(getattr(fit.disturbance, key)) for key in ("still", "driven")
    }
    slow = SLOW_DRIFT[0] in fit.candidate.learned
    wandering = WanderingVelocity(
        **disturbance,
        memory=float(fit.disturbance.memory),
        slow=float(fit.disturbance.slow) if slow else 0.0,
        slow_memory=float(fit.disturbance.slow_memory) if slow else 60.0,
    )
    return System(
        name=name,
        swimmer=swimmer_of(fit),
        dim=2,
        wandering=wandering,
        observation=Observation(noise=jitter),
        base_units=Units(length=units.get("x", "?"), time=units.get("t", "?")),
        model="kernel-potential",
        learn=_free_numbers(fit),
    )


def swimmer_of(fit: TrackFit) -> OverdampedSwimmer:
    """The first-order swimmer of a fit; the commands of each trajectory drive it."""
    flow = UniformFlow(jnp.asarray(fit.drift))
    if not fit.candidate.gains:
        return OverdampedSwimmer(ZeroForce(), ZeroForce(), 1.0, flow)
    lag = fit.parameter("log_lag")
    corner, residual = map(fit.parameter, ("log_corner", "logit_residual"))
    response = response_of(fit.candidate.response, corner, residual)
    propulsion = RollingPropulsion(
        gain=jnp.asarray(fit.gain),
        response=jax.tree.map(float, response),
        delay=fit.parameter("delay"),
        lag=math.exp(lag) if "log_lag" in fit.candidate.learned else 0.0,
    )
    return OverdampedSwimmer(propulsion, ZeroForce(), 1.0, flow)


def _free_numbers(fit: TrackFit) -> tuple[FreeNumber, ...]:
    numbers = [FreeNumber(GAIN, Flat())] if fit.candidate.gains else []
    for index, name in enumerate(fit.candidate.learned):
        if name in PATHS:
            sd = math.sqrt(max(float(fit.covariance[index, index]), 1e-12))
            numbers.append(FreeNumber(PATHS[name], _prior(name, fit, sd)))
    return (
        (*numbers, FreeNumber(DRIFT, Flat())) if fit.candidate.drifts else (*numbers,)
    )


def _prior(name: str, fit: TrackFit, sd: float) -> Normal | LogNormal:
    value = float(natural(name, jnp.asarray(fit.parameter(name))))
    if name.startswith("log_"):
        return LogNormal(median=value, deviation=sd)
    if name == "logit_residual":
        return Normal(mean=value, deviation=max(sd * value * (1 - value), 1e-6))
    return Normal(mean=value, deviation=sd)


def posterior_of(fit: TrackFit) -> Posterior:
    """Distribution of the numbers of a fitted swimmer, in their own units."""
    with jax.enable_x64(new_val=True):
        paths = [number.path for number in _free_numbers(fit)]
        rows = np.concatenate([number_slopes(fit, path) for path in paths])
        covariance = rows @ fit.covariance @ rows.T
        values = {path: number_values(fit, path) for path in paths}
        return posterior_over(swimmer_of(fit), paths, values, covariance)


def evidence_fit_of(fit: TrackFit, *, jitter: float) -> EvidenceFit:
    """The fit of a track as the result of every fit.

    Args:
        fit: a candidate on a track.
        jitter: standard deviation of single frames about the mean path [L].
    """
    posterior = posterior_of(fit)
    count = len(posterior.mean)
    nothing = Quadratic(
        point=np.zeros(0),
        hessian=np.zeros((0, 0)),
        gradient=np.zeros(0),
        squares=0.0,
        num_free=count,
        log_determinant=0.0,
    )
    return EvidenceFit(
        model=posterior.model,
        outcome=Outcome.CONVERGED,
        iterations=fit.evaluations,
        hyperparameters=Hyperparameters(np.zeros(0), 0.0, jitter, fit.log_evidence),
        posterior=posterior,
        constants=estimates_of(posterior, [n.path for n in _free_numbers(fit)]),
        states=None,
        goodness=None,
        linear=LinearFit(nothing, NoWeights(), jitter, count, 0.0),
    )


def number_values(fit: TrackFit, path: str) -> Float[np.ndarray, " number"]:
    """Numbers of a fitted swimmer by their path, flattened."""
    if path == GAIN:
        return fit.gain.ravel()
    if path == DRIFT:
        return fit.drift
    name = next(name for name, place in PATHS.items() if place == path)
    return np.asarray(natural(name, jnp.asarray(fit.parameter(name)))).reshape(1)


def number_slopes(fit: TrackFit, path: str) -> Float[np.ndarray, "number unknown"]:
    """Derivatives of these numbers by what is learned, then by all coefficients."""
    learned = fit.candidate.learned
    blank = np.zeros((4 if path == GAIN else 2, len(learned)))
    if path == GAIN:
        by_gain = fit.candidate.matrices().reshape(4, 4).T
        return np.concatenate([blank, by_gain, np.zeros((4, 2))], axis=1)
    if path == DRIFT:
        by_drift = fit.candidate.velocities().T
        return np.concatenate([blank, np.zeros((2, 4)), by_drift], axis=1)
    name = next(name for name, place in PATHS.items() if place == path)
    row = np.zeros((1, len(learned) + 6))
    at = jnp.asarray(fit.parameter(name))
    row[0, learned.index(name)] = jax.grad(lambda x: natural(name, x))(at)
    return row


def posterior_over(
    swimmer: OverdampedSwimmer,
    paths: list[str],
    values: dict[str, Float[np.ndarray, " _"]],
    covariance: Float[np.ndarray, "number number"],
) -> Posterior:
    """A posterior over numbers of a swimmer, those of `paths` in this order.

    Args:
        swimmer: the model.
        paths: where the numbers stand; the environment's weights are `environment`.
        values: best values by path, each flattened.
        covariance: of all of them, one after the other.
    """
    numbers = [FreeNumber(path) for path in paths if path != "environment"]

    def select(model: Any) -> tuple:
        weights = () if "environment" not in paths else model.environment.parameters
        weights = weights if isinstance(weights, tuple) else (weights,)
        return *weights, *(number.pick(model) for number in numbers)

    exact = eqx.tree_at(select, swimmer, replace_fn=lambda x: jnp.asarray(x, float))
    free, theta = ravel_model(exact, select)
    order = np.concatenate([_places(free, len(theta), path) for path in paths])
    mean, full = np.array(theta), np.zeros((len(theta),) * 2)
    mean[order] = np.concatenate([np.ravel(values[path]) for path in paths])
    full[np.ix_(order, order)] = covariance
    return Posterior(free, mean, full)


def _places(free: ParametricModel, count: int, path: str) -> np.ndarray:
    """Where the numbers of a path stand in the vector of a model."""
    chosen = selected_entries(free, count, FreeNumber(path).pick)
    return np.flatnonzero(chosen)


def candidate_of(
    system: System,
) -> tuple[CandidateModel, Float[np.ndarray, " parameter"]]:
    """The candidate whose free numbers are those that a system leaves open.

    Returns:
        The candidate, and all nonlinear parameters as the system states them; NaN for
        those of the noise where it states none.

    Raises:
        InputError: the system is no first-order swimmer with a uniform mobility and a
            propulsion that is driven by commands, or by none.
    """
    swimmer = system.swimmer
    if not isinstance(swimmer, OverdampedSwimmer):
        raise InputError(
            f"system {system.name!r}: expected a swimmer without inertia (order 1) for "
            "a fit with commands or a wandering velocity, got order 2"
        )
    paths = [number.path for number in system.learn]
    free = [name for name, path in PATHS.items() if path in paths]
    if system.wandering is not None and system.wandering.slow > 0:
        free += SLOW_DRIFT
    candidate = CandidateModel(
        system.name,
        gains=FULL if GAIN in paths else (),
        drifts=BOTH if DRIFT in paths else (),
        response=_response_name(swimmer),
        free=tuple(free),
    )
    return candidate, _theta(system)


def _response_name(swimmer: OverdampedSwimmer) -> str:
    propulsion = swimmer.propulsion
    if isinstance(propulsion, ZeroForce):
        return "linear"
    if not (isinstance(propulsion, RollingPropulsion) and propulsion.unbound):
        raise InputError(
            "system.propulsion: expected RollingPropulsion without a programme, or no "
            f"propulsion, got {type(propulsion).__name__}; the commands come from the "
            "trajectories"
        )
    return RESPONSE_NAMES[type(propulsion.response)]


def _theta(system: System) -> Float[np.ndarray, " parameter"]:
    """All nonlinear parameters; NaN for noise that the system does not state."""
    stated: dict[str, float] = dict(ABSENT)
    propulsion = system.swimmer.propulsion
    if isinstance(propulsion, RollingPropulsion):
        stated["delay"] = float(propulsion.delay)
        if propulsion.lag > 0:
            stated["log_lag"] = math.log(propulsion.lag)
        response = propulsion.response
        for name in CORNERS[RESPONSE_NAMES[type(response)]]:
            value = float(getattr(response, name.partition("_")[2]))
            odds = value / (1 - value) if name == "logit_residual" else value
            stated[name] = math.log(odds)
    wandering = system.wandering
    if wandering is not None:
        for name in ("still", "driven", "memory", "slow", "slow_memory"):
            stated[f"log_{name}"] = _log(getattr(wandering, name))
    stated["log_noise"] = _log(system.observation.noise)
    return np.array([stated.get(name, math.nan) for name in NAMES])


def _log(value: float) -> float:
    return math.log(value) if value > 0 else math.nan


def prior_about(theta: Float[np.ndarray, " parameter"], wide: Prior) -> Prior:
    """Priors as wide as those of a track, about what a system states."""
    stated = np.isfinite(theta)
    return Prior(np.where(stated, theta, wide.mean), wide.sd)


def estimates_of(posterior: Posterior, paths: list[str]) -> dict[str, Estimate]:
    """Learned numbers by name, with their standard deviations."""
    values: dict[str, Estimate] = {}
    sd = np.sqrt(np.maximum(np.diag(posterior.covariance), 0.0))
    for path in paths:
        places = _places(posterior.free, len(sd), path)
        for index, place in enumerate(places):
            label = path if len(places) == 1 else f"{path}[{index}]"
            if path == GAIN:
                label = f"{path}[{index // 2}, {index % 2}]"
            values[label] = Estimate(float(posterior.mean[place]), float(sd[place]))
    return values


def is_commanded(system: System) -> bool:
    """Whether a fit must be `fit_commanded`: commands or a wandering velocity."""
    commanded = isinstance(system.swimmer.propulsion, RollingPropulsion)
    return commanded or system.wandering is not None
