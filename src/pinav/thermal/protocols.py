"""Protocols: the amplitude of the field over time, with its switch times."""

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from pinav.arguments import Scalar
from pinav.errors import InputError
from pinav.thermal.quantities import Number, Numbers


class AbstractProtocol(eqx.Module):
    """The field over time: smooth between switch times, free to jump at them.

    Attributes:
        edges: begin, switch times and end [s], increasing from zero.
        frequency: of the field [Hz].
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
        """Of the whole protocol [s]."""
        return self.edges[-1]


class Piecewise(AbstractProtocol):
    """Amplitude linear between edges: `starts` to `ends` of each interval.

    Attributes:
        edges: begin, switch times and end [s].
        starts: amplitude at the begin of each interval [A m⁻¹].
        ends: at its end.
        frequency: of the field [Hz].

    Raises:
        InputError: the edges do not increase from zero, an interval has no amplitude,
            or an amplitude or the frequency is negative.
    """

    edges: tuple[float, ...] = eqx.field(static=True)
    starts: Float[Array, " interval"]
    ends: Float[Array, " interval"]
    frequency: Scalar

    def __check_init__(self) -> None:
        _check_edges(self.edges)
        for values in (self.starts, self.ends):
            if len(values) != len(self.edges) - 1:
                raise InputError(
                    f"protocol: expected {len(self.edges) - 1} amplitudes for "
                    f"{len(self.edges)} edges, got {len(values)}"
                )

    @classmethod
    def constant(
        cls, edges: Numbers, amplitudes: Numbers, frequency: Scalar
    ) -> "Piecewise":
        """A constant amplitude [A m⁻¹] between each two edges [s]."""
        values = jnp.asarray(amplitudes, float)
        return cls(edges=_times(edges), starts=values, ends=values, frequency=frequency)

    @classmethod
    def ramp(
        cls, edges: Numbers, amplitudes: Numbers, frequency: Scalar
    ) -> "Piecewise":
        """Linear between amplitudes [A m⁻¹] given at each edge [s]."""
        values = jnp.asarray(amplitudes, float)
        return cls(
            edges=_times(edges),
            starts=values[:-1],
            ends=values[1:],
            frequency=frequency,
        )

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

    def then(self, other: "Piecewise") -> "Piecewise":
        """This protocol, then another of the same frequency."""
        if self.frequency != other.frequency:
            raise InputError(
                f"then: expected the same frequency, got {self.frequency} and "
                f"{other.frequency} Hz"
            )
        later = tuple(self.duration + t for t in other.edges[1:])
        return Piecewise(
            edges=self.edges + later,
            starts=jnp.concatenate([self.starts, other.starts]),
            ends=jnp.concatenate([self.ends, other.ends]),
            frequency=self.frequency,
        )

    def until(self, time: Number) -> "Piecewise":
        """The intervals before a switch.

        Raises:
            InputError: the amplitude does not switch at that time.
        """
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
        """Largest amplitude [A m⁻¹]."""
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


def _times(edges: Numbers) -> tuple[float, ...]:
    return tuple(np.asarray(edges, float).reshape(-1).tolist())


def _check_edges(edges: tuple[float, ...]) -> None:
    gaps = np.diff(edges)
    if len(edges) < 2 or edges[0] != 0 or not np.all(gaps > 0):
        raise InputError(
            f"protocol: expected edges that increase from 0 s, got {list(edges)}"
        )
