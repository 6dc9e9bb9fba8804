"""Settings: strict structs whose numbers have a range, checked before anything runs.

This module imports no numerical library, so that `--help` is quick.
"""

import dataclasses
import math
import typing
from typing import Any, Literal

import msgspec

from pinav.errors import InputError

Number = int | float


@dataclasses.dataclass(frozen=True)
class Range:
    """The numbers that something may be; in the annotation of a setting, or by itself.

    Attributes:
        least: smallest number that is allowed.
        above: the number is larger than this.
        below: the number is smaller than this.
        most: largest number that is allowed.
        doubling: a power of two alone is allowed.
    """

    least: Number | None = None
    above: Number | None = None
    below: Number = math.inf
    most: Number | None = None
    doubling: bool = False

    def __str__(self) -> str:
        if self.doubling:
            return "a power of two, such as 256"
        if self.most is not None:
            return f"{self.least:g} to {self.most:g}"
        if self.below < math.inf and self.above is None:
            return f"{self.least:g} to below {self.below:g}"
        if self.below < math.inf:
            return f"between {self.above:g} and {self.below:g}"
        if self.above is not None:
            return f"> {self.above:g}"
        return f"{self.least:g} or more"

    def __contains__(self, number: Number) -> bool:
        low = -math.inf if self.least is None else self.least
        above = -math.inf if self.above is None else self.above
        most = math.inf if self.most is None else self.most
        is_within = low <= number <= most and above < number < self.below
        return bool(is_within) and (not self.doubling or math.log2(number).is_integer())

    def check(self, name: str, value: Any) -> None:
        """Require that the value, or each of several, lies within; words always do.

        Raises:
            InputError: it lies outside, or is not finite.
        """
        for number in value if isinstance(value, tuple) else (value,):
            if isinstance(number, int | float) and number not in self:
                raise InputError(f"{name}: expected {self}, got {number}")


@dataclasses.dataclass(frozen=True)
class Several:
    """A setting of several different values; stands in its annotation."""

    least: int = 1

    def check(self, name: str, values: tuple[Any, ...]) -> None:
        """Require so many values, none of them twice.

        Raises:
            InputError: there are fewer, or one stands twice.
        """
        for value in values:
            if values.count(value) > 1:
                raise InputError(f"{name}: {value} is given twice; drop one")
        if len(values) < self.least:
            word = "one" if self.least == 1 else f"{self.least} different ones"
            raise InputError(f"{name}: expected at least {word}, got {len(values)}")


@dataclasses.dataclass(frozen=True)
class Numbers:
    """A word of numbers with commas between them; stands in its annotation.

    Attributes:
        option: the option, where it is not called as its field.
    """

    counts: tuple[int, ...]
    option: str = ""

    def check(self, name: str, value: str | tuple[str, ...] | None) -> None:
        """Require so many finite numbers in the word, or in each of several.

        Raises:
            InputError: there are others.
        """
        for word in value if isinstance(value, tuple) else (value,):
            if word is not None:
                numbers(self.option or name, word, *self.counts)


def numbers(option: str, text: str, *counts: int) -> tuple[float, ...]:
    """Numbers with commas between them.

    Args:
        option: what the message calls them.

    Raises:
        InputError: they are not so many finite numbers.
    """
    try:
        values = tuple(float(word) for word in text.split(","))
    except ValueError:
        values = ()
    if len(values) not in counts or not all(map(math.isfinite, values)):
        example = ",".join("123456"[: counts[0]])
        raise InputError(
            f"{option}: expected {' or '.join(map(str, counts))} numbers with commas "
            f"between them, such as {example}, got {text!r}"
        )
    return values


POSITIVE = Range(above=0)
NOT_NEGATIVE = Range(least=0)
FRACTION = Range(above=0, below=1)

MAX_STEPS = 20
"""Steps of a fit, or of each of its windows, at most unless they are given."""


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Options that can be checked before anything is computed or written."""

    def check(self) -> None:
        """Check the range of each setting, and each group of settings.

        Raises:
            InputError: a setting makes no sense, alone or beside another.
        """
        hints = typing.get_type_hints(type(self), include_extras=True)
        for name in self.__struct_fields__:
            value = getattr(self, name)
            if isinstance(value, Settings):
                value.check()
                continue
            for allowed in getattr(hints[name], "__metadata__", ()):
                if isinstance(allowed, Range | Several | Numbers):
                    allowed.check(f"--{name.replace('_', '-')}", value)
        self.check_together()

    def check_together(self) -> None:
        """Refuse what a range cannot, such as settings that contradict each other.

        Raises:
            InputError: there is such a setting.
        """


class ThermalSettings(Settings, frozen=True):
    """The unknown in thermal motion: of a system, and of a fit.

    Attributes:
        observation: exact: positions without error; learn: the camera averages over an
            exposure and errs, and both are learned, so that neither biases the
            diffusion or the force; known: both are what the system states. Exact
            unless given.
        diffusion: constant: one number; field: it varies in space; tensor: it varies,
            and has a field of its own along each of --coordinates, and one along all
            others. Where the system has a thermal energy, the mobility follows from
            the diffusion (Einstein). Constant unless given.
        coordinates: Names of the coordinates on which force and diffusion depend, the
            force acting along them; all unless given.
        period: Coordinates that repeat, with their period, such as x=6.2832.
        warp: Coordinates whose kernels are finer at the end of the data where motion
            is slow, as near a wall.
        reference: The coordinate whose zero drifts slowly, such as the height above a
            wall that the focus leaves.
    """

    observation: Literal["exact", "learn", "known"] | None = None
    diffusion: Literal["constant", "field", "tensor"] | None = None
    coordinates: tuple[str, ...] = ()
    period: tuple[str, ...] = ()
    warp: tuple[str, ...] = ()
    reference: str | None = None

    @property
    def has_profile(self) -> bool:
        """The force has coordinates of its own."""
        return bool(self.coordinates or self.period or self.warp)

    def check_together(self) -> None:
        for text in self.period:
            split_period(text)


def split_period(text: str) -> tuple[str, float]:
    """Coordinate and period of a text such as `x=6.2832`.

    Raises:
        InputError: it is no such text, or the period is no number > 0.
    """
    name, separator, number = text.partition("=")
    try:
        period = float(number)
    except ValueError:
        period = 0.0
    if not (name and separator and 0 < period < float("inf")):
        raise InputError(
            f"--period: expected a coordinate and a number > 0, such as x=6.2832, got "
            f"{text!r}"
        )
    return name, period
