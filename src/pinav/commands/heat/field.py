"""The field over time of a case of `pinav heat`."""

import itertools
from typing import Annotated

from msgspec import Meta

from pinav.commands.heat.bounds import Amplitude, Frequency, Strict, Time

MOST_INTERVALS = 10_000
"""Intervals of constant amplitude; each costs a step or more."""


class Field(Strict, frozen=True):
    """Amplitudes [A/m] in intervals between times [s], at a frequency [Hz].

    In place of the amplitudes, `ramp` gives one at each time, linear between them; `on`
    and `off` [s] make bursts of the one amplitude until the last time.
    """

    frequency: Frequency
    times: tuple[Annotated[float, Meta(ge=0, le=1e7)], ...]
    amplitudes: tuple[Amplitude, ...] = ()
    ramp: tuple[Amplitude, ...] = ()
    on: Time | None = None
    off: Time | None = None

    def __post_init__(self) -> None:
        self._check_times()
        if (self.on is None) != (self.off is None):
            raise ValueError(
                "expected on and off together, got one of them; give the other"
            )
        if (count := self._intervals) > MOST_INTERVALS:
            raise ValueError(
                f"expected at most {MOST_INTERVALS:,} intervals, got {count:,.0f}; "
                "take longer bursts, or a lower constant amplitude of the same power"
            )
        if self.ramp:
            self._check_ramp()
            return
        if self.on is not None:
            self._check_bursts(self.on)
        count = 1 if self.on is not None else len(self.times) - 1
        if len(self.amplitudes) != count:
            raise ValueError(
                f"amplitudes: expected {count}, one for each interval between two "
                f"times, or one for bursts; got {len(self.amplitudes)}"
            )

    def _check_bursts(self, on: float) -> None:
        if len(self.times) != 2:
            raise ValueError(
                f"times: expected 0 and the end of the bursts, got {list(self.times)}; "
                "remove the others"
            )
        if on >= self.duration:
            raise ValueError(
                f"on: expected a burst within the protocol, < {self.duration:g} s, got "
                f"{on:g} s; shorten it, or remove on and off"
            )

    def _check_ramp(self) -> None:
        if self.amplitudes or self.on is not None:
            raise ValueError(
                "ramp: expected no amplitudes and no bursts with it; remove them"
            )
        if len(self.ramp) != len(self.times):
            raise ValueError(
                f"ramp: expected {len(self.times)} amplitudes, one at each time, got "
                f"{len(self.ramp)}"
            )

    def _check_times(self) -> None:
        if len(self.times) < 2 or self.times[0] != 0:
            raise ValueError(
                f"times: expected 0 and one later time or more, got {list(self.times)}"
            )
        gaps = [b - a for a, b in itertools.pairwise(self.times)]
        if min(gaps) <= 1e-6 * self.times[-1]:
            raise ValueError(
                "times: expected increasing times, a millionth of the last apart or "
                f"more, got {list(self.times)}; write each once, in order"
            )

    @property
    def duration(self) -> float:
        """Of the whole protocol [s]."""
        return self.times[-1]

    @property
    def _intervals(self) -> float | int:
        if self.on is None or self.off is None:
            return len(self.times) - 1
        return 2 * self.duration / (self.on + self.off)
