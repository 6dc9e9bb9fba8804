"""A fitted response as a system, and a system as a candidate model."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.actuation import (
    AbstractResponse,
    LinearResponse,
    SaturatingResponse,
    SlippingResponse,
    StepOutResponse,
)
from pinav.dynamics import OverdampedSwimmer, takes_commands
from pinav.errors import InputError
from pinav.fitting import (
    EvidenceFit,
    Hyperparameters,
    LinearFit,
    Outcome,
    Posterior,
)
from pinav.fitting.evidence.quadratic import Quadratic
from pinav.fitting.evidence.weights import NoWeights
from pinav.forces import (
    RollingPropulsion,
    UniformFlow,
    ZeroForce,
)
from pinav.identification.fit import TrackFit
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
from pinav.identification.numbers import (
    DRIFT,
    GAIN,
    PATHS,
    LearnedNumber,
    estimates_of,
    natural,
    numbers_of,
    posterior_over,
)
from pinav.identification.priors import Prior
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
from pinav.trajectories import COMMAND_UNITS, Trajectories, commands_of

RESPONSE_NAMES: dict[type[AbstractResponse], str] = {
    LinearResponse: "linear",
    SaturatingResponse: "saturating",
    SlippingResponse: "slipping",
    StepOutResponse: "step-out",
}
"""Name of each response among the candidate models."""


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


def learned_numbers(
    fit: TrackFit,
) -> tuple[list[LearnedNumber], Float[np.ndarray, "unknown unknown"]]:
    """Numbers of a fitted swimmer, and the covariance of what they depend on."""
    candidate, count = fit.candidate, len(fit.candidate.learned)
    several = [count + i for i in range(len(candidate.gains))]
    several += [count + 4 + i for i in range(len(candidate.drifts))]
    present = np.array([*range(count), *several])
    learned = [fit.parameter(name) for name in candidate.learned]
    unknown = np.concatenate([learned, fit.coefficients])[present]
    with jax.enable_x64(new_val=True):
        numbers = numbers_of(candidate, unknown)
    return numbers, fit.covariance[np.ix_(present, present)]


def posterior_of(fit: TrackFit) -> Posterior:
    """Distribution of the numbers of a fitted swimmer, in their own units."""
    with jax.enable_x64(new_val=True):
        return posterior_over(swimmer_of(fit), *learned_numbers(fit))


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
        constants=estimates_of(*learned_numbers(fit)),
        states=None,
        goodness=None,
        linear=LinearFit(nothing, NoWeights(), jitter, count, 0.0),
    )


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
    if not isinstance(propulsion, RollingPropulsion):
        raise InputError(
            "system.propulsion: expected RollingPropulsion or no propulsion beside a "
            f"wandering velocity, got {type(propulsion).__name__}"
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


def needs_kalman_filter(system: System) -> bool:
    """Whether a fit must be `fit_commanded`: commands or a wandering velocity."""
    return takes_commands(system.swimmer) or system.wandering is not None


def record_commands(system: System, data: Trajectories) -> Trajectories:
    """The data with the commands of the system's programme, where it has one.

    Those at the time of a sample are taken, to hold until the next one.

    Raises:
        InputError: the data record other commands.
    """
    stated = commands_of(system, data.times)
    for name, values in stated.items():
        recorded = data.commands.get(name)
        if recorded is not None and not np.allclose(recorded, values, equal_nan=True):
            raise InputError(
                f"system.propulsion.programme: the data record another {name} than "
                "the programme commands; leave the programme out, and the commands "
                "are those of the data"
            )
    units = {**data.units, **{name: COMMAND_UNITS[name] for name in stated}}
    return dataclasses.replace(data, commands={**data.commands, **stated}, units=units)
