"""The shared part of what commands take: strict structs, readable as TOML.

Only settings decide the numbers of a run; where it is written does not belong to them.
This module imports no numerical library, so that `--help` is quick.
"""

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
ConfigFile = Annotated[
    Path | None,
    tyro.conf.arg(
        help="TOML file with settings; options on the command line override it."
    ),
]
OutFolder = Annotated[Path, tyro.conf.arg(help="Folder of the run.")]
Resume = Annotated[
    bool,
    tyro.conf.arg(help="Continue the run in --out where it was interrupted."),
]
Overwrite = Annotated[
    bool, tyro.conf.arg(help="Replace the results that --out already holds.")
]
AsJson = Annotated[
    bool,
    tyro.conf.arg(help="Print the metrics as JSON, for scripts, and nothing else."),
]


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Options that can be checked before anything is computed or written."""

    def check(self) -> None:
        """Check each group of settings among the fields.

        Raises:
            InputError: a setting makes no sense, alone or beside another.
        """
        for name in self.__struct_fields__:
            value = getattr(self, name)
            if isinstance(value, Settings):
                value.check()


def check_counts(settings: msgspec.Struct, *names: str) -> None:
    """Require that each of these settings is 1 or more.

    Raises:
        InputError: one of them is not.
    """
    for name in names:
        value = getattr(settings, name)
        if value < 1:
            option = name.replace("_", "-")
            raise InputError(f"--{option}: expected 1 or more, got {value}")
