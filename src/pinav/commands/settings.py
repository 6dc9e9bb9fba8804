"""The shared part of what commands take: strict structs, readable as TOML.

Only settings decide the numbers of a run; where it is written does not belong to them.
This module imports no numerical library, so that `--help` is quick.
"""

import math
from pathlib import Path
from typing import Annotated, Literal

import tyro

from pinav.errors import InputError
from pinav.learning.recipes import ModelName as ModelName
from pinav.settings import Range as Range
from pinav.settings import Settings as Settings

RecipeName = Literal["default", "paper"]

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


def numbers(option: str, text: str, *counts: int) -> tuple[float, ...]:
    """Numbers with commas between them.

    Args:
        option: what the message calls them.
        text: such as "0.5,1".
        counts: how many there may be.

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
