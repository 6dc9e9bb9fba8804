"""The shared part of what commands take: strict structs, readable as TOML.

Only settings decide the numbers of a run; where it is written does not belong to them.
This module imports no numerical library, so that `--help` is quick.
"""

import dataclasses
import math
import typing
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import tyro

from pinav.errors import InputError

RecipeName = Literal["default", "paper"]

ModelName = Literal[
    "kernel-potential",
    "kernel-force",
    "kernel-mixture",
    "kernel-potential-time",
    "neural-potential",
    "neural-force",
    "ude",
    "physics-only",
    "nn-only",
]

SystemName = Annotated[
    str | None,
    tyro.conf.arg(
        help="What is known of the swimmer: a system file (.toml), module.py:name, or "
        "the name of a built-in system such as paper. The system that the data were "
        "simulated from unless given."
    ),
]
AsJson = Annotated[
    bool,
    tyro.conf.arg(help="Print the metrics as JSON, for scripts, and nothing else."),
]


Number = int | float


@dataclasses.dataclass(frozen=True)
class Range:
    """The numbers that a setting may be; stands in its annotation.

    Attributes:
        least: smallest number that is allowed.
        above: the number is larger than this.
        below: the number is smaller than this.
    """

    least: Number | None = None
    above: Number | None = None
    below: Number = math.inf

    def __str__(self) -> str:
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
        for number in value if isinstance(value, tuple) else (value,):
            if number is None:
                continue
            low = -math.inf if self.least is None else self.least
            inside = low <= number < self.below
            if not inside or (self.above is not None and number <= self.above):
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


class RunOptions(Settings, frozen=True, kw_only=True):
    """The options of every command that makes a run.

    Attributes:
        out: Folder of the run.
        overwrite: Replace the results that --out already holds.
    """

    out: Path
    overwrite: bool = False
    json: AsJson = False


class ResumableOptions(RunOptions, frozen=True, kw_only=True):
    """The options of every command whose run can be continued.

    Attributes:
        config: TOML file with settings; options on the command line override it.
        resume: Continue the run in --out where it was interrupted.
    """

    config: Path | None = None
    resume: bool = False
