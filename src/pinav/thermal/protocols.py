"""Protocols: the field over time, its limits, and steps that end at switches.

Which limit holds is the user's choice. A product of amplitude and frequency leaves out
the duty cycle; what limits in practice is the temperature that eddy currents make.
"""

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from pinav.arguments import Scalar
from pinav.errors import InputError
from pinav.thermal.quantities import Number, Numbers


def _times(edges: Numbers) -> tuple[float, ...]:
    return tuple(np.asarray(edges, float).reshape(-1).tolist())


class AbstractProtocol(eqx.Module):
    """The field over time: smooth between switch times, free to jump at them.

    Attributes:
        edges: begin, switch times and end [s], increasing from zero.
    """

    edges: eqx.AbstractVar[tuple[float, ...]]
    frequency: eqx.AbstractVar[Scalar]

    @abc.abstractmethod
    def amplitude(
        self, t: Float[Array, ""], interval: Int[Array, ""]
    ) -> Float[Array, ""]:
        """Peak amplitude [A m⁻¹] at time `t` of an interval between two edges.

        At an edge the interval says which side is meant.
        """

    @property
    def duration(self) -> float:
        return self.edges[-1]


class Piecewise(AbstractProtocol):
    """Amplitude linear between edges: `starts` to `ends` of each interval.

    Attributes:
        edges: begin, switch times and end [s].

    Raises:
        InputError: the edges do not increase from zero, an interval has no amplitude,
            or an amplitude or the frequency is negative.
    """

    edges: tuple[float, ...] = eqx.field(static=True, converter=_times)
    starts: Float[Array, " interval"]
    ends: Float[Array, " interval"]
    frequency: Scalar

    def __check_init__(self) -> None:
        edges = self.edges
        if len(edges) < 2 or edges[0] != 0 or not np.all(np.diff(edges) > 0):
            raise InputError(
                f"protocol: expected edges that increase from 0 s, got {list(edges)}"
            )
        for values in (self.starts, self.ends):
            if len(values) != len(edges) - 1:
                raise InputError(
                    f"protocol: expected {len(edges) - 1} amplitudes for {len(edges)} "
                    f"edges, got {len(values)}"
                )

    @classmethod
    def constant(
        cls, edges: Numbers, amplitudes: Numbers, frequency: Scalar
    ) -> "Piecewise":
        """A constant amplitude [A m⁻¹] between each two edges [s]."""
        values = jnp.asarray(amplitudes, float)
        return cls(edges=edges, starts=values, ends=values, frequency=frequency)

    @classmethod
    def ramp(
        cls, edges: Numbers, amplitudes: Numbers, frequency: Scalar
    ) -> "Piecewise":
        """Linear between amplitudes [A m⁻¹] given at each edge [s]."""
        values = jnp.asarray(amplitudes, float)
        starts, ends = values[:-1], values[1:]
        return cls(edges=edges, starts=starts, ends=ends, frequency=frequency)

    @classmethod
    def on_off(
        cls,
        amplitude: Scalar,
        frequency: Scalar,
        *,
        on: Number,
        off: Number,
        duration: Number,
    ) -> "Piecewise":
        """Bursts of `on` seconds, `off` seconds apart, until `duration` [s]."""
        if not (on > 0 and off > 0 and duration > 0):
            raise InputError(
                f"on_off: expected times > 0 s, got on {on}, off {off}, duration "
                f"{duration}"
            )
        edges = [0.0]
        while edges[-1] < duration:
            edges.append(edges[-1] + (on if len(edges) % 2 else off))
        edges[-1] = duration
        bursts = 1.0 - np.arange(len(edges) - 1) % 2
        return cls.constant(edges, amplitude * jnp.asarray(bursts), frequency)

    def until(self, time: Number) -> "Piecewise":
        """The intervals before a switch."""
        if time not in self.edges[1:]:
            raise InputError(
                f"until: expected a switch or the end, {list(self.edges[1:])} s, got "
                f"{time:g} s"
            )
        count = self.edges.index(time)
        return Piecewise(
            edges=self.edges[: count + 1],
            starts=self.starts[:count],
            ends=self.ends[:count],
            frequency=self.frequency,
        )

    @property
    def largest(self) -> float:
        return float(jnp.maximum(self.starts.max(), self.ends.max()))

    def amplitude(
        self, t: Float[Array, ""], interval: Int[Array, ""]
    ) -> Float[Array, ""]:
        # By the interval, not by a search in time: at an edge both sides are needed.
        times = jnp.asarray(self.edges)
        begin, end = times[interval], times[interval + 1]
        fraction = (t - begin) / (end - begin)
        change = self.ends[interval] - self.starts[interval]
        return self.starts[interval] + fraction * change


COINCIDENT = 1e-9
"""Times closer than this, relative to the duration, are one time."""


class Schedule(eqx.Module):
    """All steps of a run, none of which crosses a switch or a saved time.

    Steps of no length fill up the last block, so that blocks are equal.

    Attributes:
        intervals: of the protocol, in which each step lies.
        saved: indices of the steps whose ends are the saved times.
        block: steps whose states are recomputed together in reverse mode.
    """

    starts: Float[np.ndarray, " step"]
    steps: Float[np.ndarray, " step"]
    intervals: Int[np.ndarray, " step"]
    saved: Int[np.ndarray, " time"]
    times: Float[np.ndarray, " time"]
    block: int = eqx.field(static=True)


def plan_steps(
    protocol: AbstractProtocol,
    longest: Number,
    *,
    save_every: Number | None = None,
    save_at: Numbers | None = None,
    start: Number = 0.0,
) -> Schedule:
    """Equal steps between each two events, as long as allowed.

    Args:
        protocol: whose edges are events.
        longest: longest step [s].
        save_every: interval [s] between saved times; the end is saved too.
        save_at: saved times [s], in place of `save_every`; the end alone unless given.
        start: time [s] at which the run begins, after a restart.

    Raises:
        InputError: a saved time or the start is outside the protocol.
    """
    end = protocol.duration
    if not 0 <= start < end:
        raise InputError(
            f"schedule start: expected within 0 and {end:g} s, got {start:g}"
        )
    times = _saved_times(start, end, save_every, save_at)
    inner = [t for t in protocol.edges if start < t < end]
    events = _merge(np.concatenate([[start, end], inner, times]), end)
    # less a little, so that rounding does not add a step
    counts = np.maximum(np.ceil(np.diff(events) / longest - 1e-9), 1).astype(int)
    steps = np.repeat(np.diff(events) / counts, counts)
    starts = np.concatenate(
        [
            a + (b - a) * np.arange(n) / n
            for a, b, n in zip(events[:-1], events[1:], counts, strict=True)
        ]
    )
    # by the middle of a step, because its ends may coincide with edges up to rounding
    middles = starts + 0.5 * steps
    intervals = np.searchsorted(protocol.edges, middles) - 1
    ends = np.append(0, np.cumsum(counts)) - 1
    nearest = np.abs(events[:, None] - times[None]).argmin(axis=0)
    # the square root balances kept and recomputed states in reverse mode
    block = max(1, int(np.ceil(np.sqrt(len(steps)))))
    padding = -len(steps) % block
    return Schedule(
        starts=np.append(starts, np.full(padding, end)),
        steps=np.append(steps, np.zeros(padding)),
        intervals=np.append(intervals, np.full(padding, intervals[-1])),
        saved=ends[nearest],
        times=times,
        block=block,
    )


def _saved_times(
    start: Number, end: Number, save_every: Number | None, save_at: Numbers | None
) -> np.ndarray:
    if save_at is not None:
        times = np.asarray(save_at, float).reshape(-1)
        outside = (times <= start) | (times > end * (1 + COINCIDENT))
        if outside.any():
            raise InputError(
                f"saved time {times[outside][0]:g} s: expected after {start:g} and up "
                f"to {end:g} s, the end of the protocol"
            )
        return np.unique(times)
    if save_every is None:
        return np.array([end])
    if not save_every > 0:
        raise InputError(f"save_every: expected a time > 0 s, got {save_every}")
    count = int(np.floor((end - start) / save_every * (1 + COINCIDENT)))
    times = start + save_every * np.arange(1, count + 1)
    return _merge(np.append(times, end), end)


def _merge(times: np.ndarray, end: Number) -> np.ndarray:
    ordered = np.sort(times)
    kept = np.append(True, np.diff(ordered) > COINCIDENT * end)
    return ordered[kept]


class HfLimit(eqx.Module):
    """A bound on the product of amplitude and frequency.

    Attributes:
        product: largest $Hf$ [A m⁻¹ s⁻¹], positive.
    """

    product: Number
    name: str = eqx.field(static=True, default="Hf limit")

    def __check_init__(self) -> None:
        if not self.product > 0:
            raise InputError(
                f"HfLimit.product: expected > 0 A/(m s), got {self.product}"
            )

    def exposure(self, protocol: Piecewise) -> Float[Array, " interval"]:
        """$Hf$ of each interval, differentiable by the amplitudes.

        The largest of them has a kink, at which an optimiser stops.
        """
        return jnp.maximum(protocol.starts, protocol.ends) * protocol.frequency


ATKINSON_BREZOVICH = HfLimit(product=4.85e8, name="Atkinson-Brezovich limit")
"""Tolerated for over an hour by a torso of some 30 cm: Atkinson, Brezovich and
Chakraborty, IEEE Trans. Biomed. Eng. 31, 70 (1984)."""

HERGT_DUTZ = HfLimit(product=5e9, name="Hergt-Dutz limit")
"""Proposed for smaller exposed regions: Hergt and Dutz, J. Magn. Magn. Mater. 311, 187
(2007)."""

LIMITS = {"atkinson-brezovich": ATKINSON_BREZOVICH, "hergt-dutz": HERGT_DUTZ}


def require(protocol: Piecewise, *limits: HfLimit) -> None:
    """Refuse a protocol that exceeds a limit."""
    for limit in limits:
        reached = float(jnp.max(limit.exposure(protocol)))
        if reached > limit.product * (1 + 1e-9):
            raise InputError(
                f"protocol exceeds the {limit.name}: expected <= {limit.product:.4g} "
                f"A/(m s), got {reached:.4g} A/(m s); lower the amplitude or "
                "the frequency, or choose another limit"
            )
