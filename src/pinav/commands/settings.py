"""Settings of the jobs: strict, nested in nothing, readable as TOML.

Only these decide the numbers of a run; where it is written does not belong here.
This module imports no numerical library, so that `--help` is quick.
"""

from typing import Literal

import msgspec

from pinav.errors import InputError

RecipeName = Literal["default", "paper"]


def _check_counts(settings: msgspec.Struct, *names: str) -> None:
    for name in names:
        value = getattr(settings, name)
        if value < 1:
            option = name.replace("_", "-")
            raise InputError(f"--{option}: expected 1 or more, got {value}")
