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
    """The numbers that a setting may be; stands in its annotation.

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
        if self.below < math.inf:
            return f"between {self.above:g} and {self.below:g}"
        if self.above is not None:
            return f"a number > {self.above:g}"
        return f"{self.least:g} or more"

    def check(self, name: str, value: Number | tuple[Number, ...] | None) -> None:
        """Require that the value, or each of several, lies within; none always does.

        Raises:
            InputError: it lies outside, or is not finite.
        """
        low = -math.inf if self.least is None else self.least
        above = -math.inf if self.above is None else self.above
        most = math.inf if self.most is None else self.most
        for number in value if isinstance(value, tuple) else (value,):
            if number is None:
                continue
            if not (low <= number <= most and above < number < self.below):
                option = name.replace("_", "-")
                raise InputError(f"--{option}: expected {self}, got {number}")


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
                    allowed.check(name, value)
        self.check_together()

    def check_together(self) -> None:
        """Refuse what a range cannot, such as settings that contradict each other.

        Raises:
            InputError: there is such a setting.
        """
