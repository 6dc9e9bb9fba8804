"""Likelihood of a recording of a trapped bead: a Kalman filter of three states.

The states are the bead's distance from where its trap would hold it, its mean over the
exposure, and the wander of the trap. The gains follow from the times alone; with equal
intervals they settle, and only means are filtered from there on.
"""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from validation.truth.trap_fit.model import (
    Propagator,
    TrapModel,
    blur_factor,
    propagate,
)

SETTLED = 1024
"""Frames after which the gain of a filter with equal intervals has its last value."""


class _Filter(NamedTuple):
    """Gains of each frame, and the variance of its innovation."""

    gain: Float[Array, "frame 3"]
    variance: Float[Array, " frame"]


def _gains(trap: TrapModel, intervals: Array, count: int) -> _Filter:
    """Gains of the first frames; the rest has the last one's, with equal intervals."""
    steps = propagate(trap, intervals)
    kept = jnp.exp(-intervals / trap.memory)
    stationary, slow = trap.diffusion / trap.rate, trap.wander**2
    # The start is stationary: its mean over the exposure lies before the first frame.
    ratio = trap.rate * trap.exposure
    mean = -jnp.expm1(-ratio) / ratio
    start = _symmetric(
        stationary, stationary * mean, stationary * blur_factor(ratio), slow
    )

    def update(covariance: Array) -> tuple[Array, Array, Array]:
        observed = covariance[1] + covariance[2]
        variance = observed[1] + observed[2] + trap.error**2
        gain = observed / variance
        return gain, variance, covariance - gain[:, None] * observed[None]

    def step(covariance: Array, inputs: tuple[Propagator, Array]) -> tuple:
        p, keep = inputs
        gain, variance, after = update(covariance)
        # Of the state alone e and the wander are carried on; the old mean is forgotten.
        ee, es, ss = after[0, 0], after[0, 2] * keep, after[2, 2] * keep**2
        ss = ss - slow * jnp.expm1(jnp.log(keep) * 2)
        ahead = _symmetric(
            p.decay**2 * ee + p.noise,
            p.decay * p.reach * ee + p.mixed,
            p.reach**2 * ee + p.blurred,
            ss,
            (p.decay * es, p.reach * es),
        )
        return ahead, (gain, variance)

    inputs = (jax.tree.map(lambda part: part[: count - 1], steps), kept[: count - 1])
    last, (gains, variances) = jax.lax.scan(step, start, inputs)
    gain, variance, _ = update(last)
    return _Filter(
        jnp.concatenate([gains, gain[None]]), jnp.append(variances, variance)
    )


def _symmetric(
    ee: Array, em: Array, mm: Array, ss: Array, slow: tuple[Array, Array] | None = None
) -> Array:
    """Covariance of e, its mean over the exposure and the wander."""
    es, ms = (jnp.zeros_like(ee),) * 2 if slow is None else slow
    rows = [[ee, em, es], [em, mm, ms], [es, ms, ss]]
    return jnp.stack([jnp.stack(row) for row in rows])


class TrapData(eqx.Module):
    """One recording of a bead in a trap, in units of its own scales.

    Attributes:
        times: [T].
        positions: [L].
        drive: where the trap was commanded to be [L]; zeros where it rests.
        even: the intervals are equal.
    """

    times: Float[Array, " frame"]
    positions: Float[Array, " frame"]
    drive: Float[Array, " frame"]
    even: bool = eqx.field(static=True)

    @property
    def intervals(self) -> Float[Array, " step"]:
        """Durations from frame to frame [T]."""
        return jnp.diff(self.times)

    def mean_path(self, trap: TrapModel) -> Float[Array, " frame"]:
        """Mean position over each exposure of a bead that no heat moves [L].

        The drive is linear from frame to frame; before the first frame it moved as in
        the first interval.
        """
        tau = self.intervals
        speed = jnp.diff(self.drive) / tau
        decay = jnp.exp(-trap.rate * tau)

        def step(offset: Array, inputs: tuple[Array, Array]) -> tuple[Array, Array]:
            part, drift = inputs
            lag = drift / trap.rate
            return -lag + (offset + lag) * part, offset

        first = -speed[0] / trap.rate
        last, offsets = jax.lax.scan(step, first, (decay, speed))
        later = jnp.append(offsets[1:], last)
        # Over the exposure before a frame: the drive's mean, the lag and its transient.
        lag, ratio = speed / trap.rate, trap.rate * trap.exposure
        mean = self.drive[1:] - speed * trap.exposure / 2 - lag
        mean = mean + (later + lag) * jnp.expm1(ratio) / ratio
        start = self.drive[0] - speed[0] * trap.exposure / 2 + first
        return jnp.concatenate([start[None], mean])


class TrapLikelihood(NamedTuple):
    """What a filter says of one recording.

    Attributes:
        innovations: with the mean taken out, in their own deviation.
        log_variances: of each.
        mean: offset of the recording from the drive [L].
        mean_sd: its standard deviation [L].
    """

    innovations: Float[Array, " frame"]
    log_variances: Float[Array, " frame"]
    mean: Float[Array, ""]
    mean_sd: Float[Array, ""]

    @property
    def log_likelihood(self) -> Float[Array, ""]:
        """Restricted: the mean has a flat prior."""
        size = self.innovations.shape[0] - 1
        fit = jnp.sum(self.innovations**2) + jnp.sum(self.log_variances)
        return -0.5 * (fit + size * math.log(2 * math.pi)) + jnp.log(self.mean_sd)


def trap_likelihood(trap: TrapModel, data: TrapData) -> TrapLikelihood:
    """Filter a recording, its mean by least squares of the whitened columns."""
    size = data.times.shape[0]
    count = min(SETTLED, size) if data.even else size
    gains = _gains(trap, data.intervals, count)
    repeat = [(0, size - count)]
    gain = jnp.pad(gains.gain, [*repeat, (0, 0)], mode="edge")
    variance = jnp.pad(gains.variance, repeat, mode="edge")
    steps = propagate(trap, data.intervals)
    kept = jnp.exp(-data.intervals / trap.memory)
    ones = jnp.ones(1)
    onward = [
        jnp.concatenate([part, 0 * ones]) for part in (steps.decay, steps.reach, kept)
    ]
    deviations = data.positions - data.mean_path(trap)
    columns = jnp.stack([deviations, jnp.ones_like(deviations)], axis=1)

    def step(state: Array, inputs: tuple[Array, ...]) -> tuple[Array, Array]:
        row, weight, decay, reach, keep = inputs
        innovation = row - state[1] - state[2]
        after = state + weight[:, None] * innovation[None]
        ahead = jnp.stack([decay * after[0], reach * after[0], keep * after[2]])
        return ahead, innovation

    start = jnp.zeros((3, 2))
    raw = jax.lax.scan(step, start, (columns, gain, *onward))[1]
    white = raw / jnp.sqrt(variance)[:, None]
    information = jnp.sum(white[:, 1] ** 2)
    mean = jnp.sum(white[:, 0] * white[:, 1]) / information
    return TrapLikelihood(
        white[:, 0] - mean * white[:, 1],
        jnp.log(variance),
        mean,
        1 / jnp.sqrt(information),
    )
