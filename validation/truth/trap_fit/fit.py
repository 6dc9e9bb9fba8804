r"""`fit_trap`: stiffness and relaxation of a linear trap, by its exact state space.

The distance $e$ of a bead from where its trap would hold it obeys

$$de = -\lambda e\,dt + \sqrt{2D}\,dW,$$

and a camera records $y_n = \frac1T\int_{t_n - T}^{t_n} e\,ds + $ error. The exposure's
integral is a second state, so that steps need not be short against $1/\lambda$. A trap
that wanders is a third state, an Ornstein-Uhlenbeck process. A known drive moves the
trap, and the mean is eliminated with a flat prior.
"""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from validation.truth.trap_fit.likelihood import (
    TrapData,
    TrapLikelihood,
    trap_likelihood,
)
from validation.truth.trap_fit.model import TrapModel

from pinav.errors import FitError, InputError
from pinav.fitting.engine.posterior import Estimate

STEPS = 60
"""Scoring steps of one search at most."""

AT_REST, WANDERING = 4, 6
"""Numbers that are sought of a trap that rests, and of one that wanders."""

FIRST = np.array([math.log(0.3), 0.0, 0.0, math.log(0.1), -40.0, 0.0])
"""Where a search begins: a trap at rest, in units of frames and steps."""

MEMORIES = (10.0, 100.0)
"""Where a search begins: correlation times of the wander over relaxation times."""

PRIOR_MEAN = np.array(
    [math.log(0.3), 0.0, 0.0, math.log(0.1), math.log(0.2), math.log(30.0)]
)
PRIOR_SD = np.array([3.0, 3.0, 1.5, 1.5, 1.0, 1.5])
"""Normal priors of the numbers: relaxation rate times the interval, diffusion over that
of free steps, exposure (a logit), error over the diffusion of an interval, wander over
the bead's own deviation, and its memory over the relaxation time; logarithms."""


def fit_trap(
    times: ArrayLike,
    positions: ArrayLike,
    *,
    drive: ArrayLike | None = None,
    wander: bool | None = None,
) -> "TrapFit":
    r"""Relaxation, diffusion, exposure and error of a bead in a linear trap.

    Maximum of likelihood times weak priors: the exposure lies between zero and the
    shortest interval, the error is about a tenth of $\sqrt{D\tau}$ within a factor of
    20, rate and diffusion are all but flat in their logarithms. Lengths and times may
    have any unit. Expected: with 8000 frames at $\lambda\tau = 0.4$ the stiffness has a
    standard deviation of 3 %. It fails where the bead hardly relaxes in the whole
    recording, which the bands show.

    Args:
        times: of each frame [T], increasing; lost frames are left out.
        positions: of the bead [L].
        drive: position of the trap as it was commanded [L]; at rest unless given.
        wander: whether the trap wanders slowly too; the evidence chooses unless given.

    Raises:
        InputError: fewer than 30 frames, arrays of different length, numbers that are
            not finite, times that do not increase or positions that never change.
        FitError: the likelihood is not finite.
    """
    data, scale = _in_own_units(times, positions, drive)
    with jax.enable_x64(new_val=True):
        still = _search(data, FIRST, AT_REST)
        if wander is False:
            return _result(still, None, scale)
        searches = []
        for memory in MEMORIES:
            start = still.best.copy()
            start[AT_REST:] = math.log(0.2), math.log(memory)
            searches.append(_search(data, start, WANDERING))
        moving = max(searches, key=lambda search: search.log_evidence)
        advantage = moving.log_evidence - still.log_evidence
        chosen = moving if wander or advantage > 0 else still
        return _result(chosen, advantage, scale)


class TrapFit(eqx.Module):
    r"""A fitted trap; standard deviations are those of Laplace's method.

    Attributes:
        rate: $\lambda$ [T⁻¹].
        relaxation: $1 / \lambda$ [T].
        diffusion: $D$ [L² T⁻¹].
        rate_over_diffusion: $\lambda / D$ [L⁻²], the stiffness over $k_B T$.
        exposure: effective exposure [T].
        error: localisation error [L].
        mean: offset of the bead from where the drive would hold it [L].
        wander: standard deviation of the wandering trap [L]; None where it rests.
        memory: correlation time of the wander [T]; None where it rests.
        correlations: of the innovations at lags 1 to 5; within $2 / \sqrt N$ of 0
            where the model explains the N frames.
        advantage: log evidence of a wandering trap over one at rest [nats]; None where
            it was not tried.
        converged: the search ended at a maximum.
    """

    rate: Estimate
    relaxation: Estimate
    diffusion: Estimate
    rate_over_diffusion: Estimate
    exposure: Estimate
    error: Estimate
    mean: Estimate
    wander: Estimate | None
    memory: Estimate | None
    correlations: Float[np.ndarray, " lag"]
    advantage: float | None
    converged: bool

    def stiffness(self, thermal_energy: float) -> Estimate:
        r"""Stiffness $k = k_B T \lambda / D$ [F L⁻¹].

        Args:
            thermal_energy: $k_B T$ [F L].
        """
        ratio = self.rate_over_diffusion
        return Estimate(thermal_energy * ratio.value, thermal_energy * ratio.sd)

    def lag(self, speed: float) -> Estimate:
        r"""Distance $v / \lambda$ [L] by which the bead lags behind a moving trap.

        Args:
            speed: $v$ of the trap [L T⁻¹].
        """
        return Estimate(speed * self.relaxation.value, abs(speed) * self.relaxation.sd)


class _Scale(NamedTuple):
    """Units of a search: the interval [T], the deviation of a step, the origin [L]."""

    time: float
    length: float
    origin: float


def _in_own_units(
    times: ArrayLike, positions: ArrayLike, drive: ArrayLike | None
) -> tuple[TrapData, _Scale]:
    t, x = np.asarray(times, float), np.asarray(positions, float)
    u = np.zeros_like(x) if drive is None else np.asarray(drive, float)
    if t.ndim != 1 or t.shape != x.shape or u.shape != x.shape or len(t) < 30:
        raise InputError(
            "fit_trap: expected 30 or more times and as many positions (and drive), "
            f"got shapes {t.shape}, {x.shape} and {u.shape}"
        )
    if not all(np.isfinite(part).all() for part in (t, x, u)):
        raise InputError("fit_trap: expected finite numbers; leave lost frames out")
    tau = np.diff(t)
    if not (tau > 0).all():
        raise InputError("fit_trap times: expected increasing ones; sort the frames")
    length = float(np.std(np.diff(x - u)))
    if length == 0:
        raise InputError("fit_trap positions: expected ones that change, got one place")
    even = bool(np.ptp(tau) < 1e-3 * tau.min())
    time = float(np.mean(tau) if even else tau.min())
    if even:  # what digits are left of the times is not their irregularity
        t = np.arange(len(t)) * time
    scale = _Scale(time, length, float(x[0] - u[0]))
    data = TrapData(
        jnp.asarray((t - t[0]) / time),
        jnp.asarray((x - x[0]) / length),
        jnp.asarray((u - u[0]) / length),
        even,
    )
    return data, scale


def _trap(numbers: Float[Array, "6"]) -> TrapModel:
    """The trap that the numbers of a search stand for."""
    rate, diffusion = jnp.exp(numbers[0]), jnp.exp(numbers[1])
    return TrapModel(
        rate,
        diffusion,
        exposure=LEAST + (LARGEST - LEAST) * jax.nn.sigmoid(numbers[2]),
        error=jnp.exp(numbers[3]) * jnp.sqrt(diffusion),
        wander=jnp.exp(numbers[4]) * jnp.sqrt(diffusion / rate),
        memory=jnp.exp(numbers[5]) / rate,
    )


LEAST, LARGEST = 1e-3, 0.999
"""Exposures that a search allows, in intervals."""


class _Expansion(NamedTuple):
    """The log posterior about one set of numbers.

    Attributes:
        value: log posterior.
        gradient: of it.
        information: expected, and that of the prior.
        likelihood: the filtered recording.
    """

    value: Float[Array, ""]
    gradient: Float[Array, "6"]
    information: Float[Array, "6 6"]
    likelihood: TrapLikelihood


@eqx.filter_jit
def _expand(numbers: Float[Array, "6"], data: TrapData) -> _Expansion:
    def parts(numbers: Array) -> tuple[tuple[Array, Array, Array], TrapLikelihood]:
        result = trap_likelihood(_trap(numbers), data)
        whitened = result.innovations, result.log_variances, jnp.log(result.mean_sd)
        return whitened, result

    (white, logs, ends), result = jax.jacfwd(parts, has_aux=True)(numbers)
    z = result.innovations
    gradient = -z @ white - 0.5 * jnp.sum(logs, axis=0) + ends
    moved = white + 0.5 * z[:, None] * logs  # the innovation's own derivative
    information = moved.T @ moved + 0.5 * logs.T @ logs
    return _Expansion(result.log_likelihood, gradient, information, result)


class _Search(NamedTuple):
    """Where a search ended."""

    best: Float[np.ndarray, "6"]
    covariance: Float[np.ndarray, "number number"]
    log_evidence: float
    likelihood: TrapLikelihood
    converged: bool


def _posterior(
    numbers: Float[np.ndarray, "6"], data: TrapData, size: int
) -> tuple[float, np.ndarray, np.ndarray, TrapLikelihood]:
    """Log posterior of the first numbers, its gradient and information."""
    expansion = _expand(jnp.asarray(numbers), data)
    mean, sd = PRIOR_MEAN[:size], PRIOR_SD[:size]
    off = (numbers[:size] - mean) / sd
    prior = -np.sum(0.5 * off**2 + np.log(sd) + 0.5 * math.log(2 * math.pi))
    gradient = np.asarray(expansion.gradient)[:size] - off / sd
    information = np.asarray(expansion.information)[:size, :size] + np.diag(sd**-2.0)
    value = float(expansion.value) + float(prior)
    return value, gradient, information, expansion.likelihood


def _search(data: TrapData, start: Float[np.ndarray, "6"], size: int) -> _Search:
    """Maximise the posterior of the first `size` numbers by damped scoring."""
    here, damping, converged = start.copy(), 1e-3, False
    value, gradient, information, likelihood = _posterior(here, data, size)
    if not np.isfinite(value):
        raise FitError("fit_trap: the likelihood is not finite; check the positions")
    for _ in range(STEPS):
        damped = information + damping * np.diag(np.diag(information))
        step = np.clip(np.linalg.solve(damped, gradient), -1.0, 1.0)
        ahead = here.copy()
        ahead[:size] += step
        tried = _posterior(ahead, data, size)
        gain = tried[0] - value
        if gain >= -1e-9:
            here, (value, gradient, information, likelihood) = ahead, tried
            damping = max(damping / 10, 1e-6)
            converged = gain < 1e-4 and bool(np.abs(step).max() < 1e-2)
        else:  # and where the value is not a number
            damping *= 10
        if converged or damping > 1e8:
            break
    covariance = np.linalg.inv(information)
    volume = np.linalg.slogdet(covariance)[1] + size * math.log(2 * math.pi)
    return _Search(here, covariance, value + 0.5 * volume, likelihood, converged)


def _result(search: _Search, advantage: float | None, scale: _Scale) -> TrapFit:
    best, covariance = search.best, search.covariance
    size, result = len(covariance), search.likelihood

    def power(unit: float, **powers: float) -> Estimate:
        """Product of powers of the numbers, which are logarithms."""
        exponents = np.array([powers.get(name, 0.0) for name in NAMES])
        value = float(np.exp(exponents @ best)) * unit
        slope = exponents[:size]
        return Estimate(value, value * float(np.sqrt(slope @ covariance @ slope)))

    part = 1 / (1 + math.exp(-best[2]))
    reach = (LARGEST - LEAST) * scale.time
    exposure = LEAST * scale.time + reach * part
    exposure_sd = reach * part * (1 - part) * float(np.sqrt(covariance[2, 2]))
    white = np.asarray(result.innovations)
    correlations = [white[k:] @ white[:-k] / (white @ white) for k in range(1, 6)]
    length, time, wanders = scale.length, scale.time, size == WANDERING
    mean_sd = float(result.mean_sd) * length
    return TrapFit(
        rate=power(1 / time, rate=1.0),
        relaxation=power(time, rate=-1.0),
        diffusion=power(length**2 / time, diffusion=1.0),
        rate_over_diffusion=power(length**-2, rate=1.0, diffusion=-1.0),
        exposure=Estimate(exposure, exposure_sd),
        error=power(length, error=1.0, diffusion=0.5),
        mean=Estimate(scale.origin + float(result.mean) * length, mean_sd),
        wander=power(length, wander=1.0, diffusion=0.5, rate=-0.5) if wanders else None,
        memory=power(time, memory=1.0, rate=-1.0) if wanders else None,
        correlations=np.array(correlations),
        advantage=advantage,
        converged=search.converged,
    )


NAMES = ("rate", "diffusion", "exposure", "error", "wander", "memory")
"""What the numbers of a search stand for."""
