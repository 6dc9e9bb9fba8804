"""Settings: strict structs whose numbers have a range, checked before anything runs.

This module imports no numerical library, so that `--help` is quick.
"""

import dataclasses
import math
import typing

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
    """

    least: Number | None = None
    above: Number | None = None
    below: Number = math.inf
    most: Number | None = None

    def __str__(self) -> str:
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
        return low <= number <= most and above < number < self.below

    def check(self, name: str, value: Number | tuple[Number, ...] | None) -> None:
        """Require that the value, or each of several, lies within; none always does.

        Raises:
            InputError: it lies outside, or is not finite.
        """
        for number in value if isinstance(value, tuple) else (value,):
            if number is not None and number not in self:
                raise InputError(f"{name}: expected {self}, got {number}")


POSITIVE = Range(above=0)
NOT_NEGATIVE = Range(least=0)
FRACTION = Range(above=0, below=1)


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
                if isinstance(allowed, Range):
                    allowed.check(f"--{name.replace('_', '-')}", value)
        self.check_together()

    def check_together(self) -> None:
        """Refuse what a range cannot, such as settings that contradict each other.

        Raises:
            InputError: there is such a setting.
        """
