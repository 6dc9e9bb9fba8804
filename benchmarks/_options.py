"""What every benchmark does first with its words and with its kept results."""

from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import jax
import msgspec
import numpy as np

from pinav.commands.parsing import parse
from pinav.commands.settings import Settings
from pinav.errors import InputError

Options = TypeVar("Options", bound=Settings)
Kept = TypeVar("Kept")


def begin(kind: type[Options], argv: Sequence[str], name: str) -> Options | None:
    """The options of a benchmark, checked, and double precision; None after --help.

    Args:
        kind: of the options.
        argv: the words after the name of the benchmark.
        name: of the benchmark.

    Raises:
        InputError: a word is unknown, or an option makes no sense.
    """
    options = parse(kind, argv, prog=f"python -m benchmarks {name}")
    if options is not None:
        options.check()
        jax.config.update("jax_enable_x64", val=True)
    return options


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Arrays that an earlier call has kept.

    Raises:
        InputError: they are missing or damaged.
    """
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as kept:
            return dict(kept)
    except Exception as error:
        raise InputError(
            f"{path} cannot be read ({error}); delete all files of that name and "
            "repeat the benchmark"
        ) from error


def read_kept(path: Path, kind: type[Kept]) -> Kept:
    """A measurement that an earlier call has kept as JSON.

    Raises:
        InputError: it is damaged.
    """
    try:
        return msgspec.json.decode(path.read_bytes(), type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputError(
            f"{path} cannot be read ({error}); delete it and repeat the benchmark"
        ) from error
