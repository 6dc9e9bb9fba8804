"""Settings: strict structs whose numbers have a range, checked before anything runs.

This module imports no numerical library, so that `--help` is quick.
"""

import dataclasses
import math
import typing
from typing import Any

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
