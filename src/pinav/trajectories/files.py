"""Trajectories on disk: `.npz` for machines, `.csv` for everything else.

A CSV file has the columns `t` and one for each channel, and `trajectory` where it
holds several. An empty cell is a missing observation, and a heading may state a unit:
`x [um]`. Columns are separated by commas, or by semicolons, with decimal points or
decimal commas. What the columns cannot say stands in a first line `# pinav: {...}`, all
of whose entries are optional: `channels`, `commands` (names of columns that are
commands), `units`, `provenance`.
"""

import dataclasses
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

from pinav.errors import InputError
from pinav.files import atomic_write, check_destination, check_regular
from pinav.trajectories.csv_files import PREFIX, delimiter_of, read_csv, write_csv
from pinav.trajectories.npz_files import is_foreign, read_npz, write_npz
from pinav.trajectories.trajectories import Trajectories
from pinav.trajectories.trajectory import split_headings

Function = TypeVar("Function", bound=Callable)


def save(
    trajectories: Trajectories, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write trajectories to a `.npz` or `.csv` file; both keep every digit.

    Raises:
        InputError: the suffix is another, the file exists and `overwrite` is false,
            or the file cannot be written; then nothing of it is left behind.
    """
    write = _by_suffix(path, WRITERS)
    atomic_write(path, lambda file: write(trajectories, file), overwrite=overwrite)


WRITERS = {".npz": write_npz, ".csv": write_csv}
"""Writers of files, by suffix."""


def check_savable(path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Refuse a file that `save` would refuse, before the work whose result it holds.

    Raises:
        InputError: the suffix is another, the file exists and `overwrite` is false, or
            there is no folder for it.
    """
    _by_suffix(path, WRITERS)
    check_destination(path, overwrite=overwrite)


def load(
    path: str | os.PathLike[str], *, units: Mapping[str, str] | None = None
) -> Trajectories:
    """Read trajectories from a `.npz` or `.csv` file; nothing in it is executed.

    Args:
        units: unit of any channel, command or `t`, overriding the file's.

    Raises:
        InputError: the file cannot be read, or is not what its suffix says; the
            message names the file and the place in it.
    """
    read = _by_suffix(path, {".npz": read_npz, ".csv": read_csv})
    try:
        check_regular(path)
        with open(path, "rb") as file:
            trajectories = read(file)
        for name in units or {}:
            if name not in trajectories.units:
                raise InputError(
                    f"units: {name!r} is no column; expected some of "
                    f"{', '.join(trajectories.units)}"
                )
    except InputError as error:
        raise InputError(f"{os.fspath(path)}: {error}") from error
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"{os.fspath(path)}: cannot read: {reason}") from error
    stated = {**trajectories.units, **(units or {})}
    return dataclasses.replace(trajectories, units=stated)


def is_trajectories(path: str | os.PathLike[str]) -> bool:
    """True for a file in the form of `save`: `.npz`, or a CSV with a column t.

    Tables with other names of tracks, and archives without the arrays of `save`, belong
    to trackers. A file that cannot be opened counts as one, so that `load` reports the
    cause.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".npz":
        return not is_foreign(path)
    if suffix != ".csv":
        return False
    try:
        check_regular(path)
        with open(path, encoding="utf-8-sig", errors="replace") as file:
            first = file.readline()
    except (OSError, InputError):
        return True
    names, _ = split_headings(first.split(delimiter_of(first)))
    return first.startswith(PREFIX) or ("t" in names and not TRACKS & set(names))


TRACKS = frozenset({"ID", "track_id", "particle", "TRACK_ID"})
"""Names of the column of tracks in tables of trackers, which also have a column t."""


def _by_suffix(
    path: str | os.PathLike[str], functions: dict[str, Function]
) -> Function:
    suffix = Path(path).suffix.lower()
    if suffix not in functions:
        known = " or ".join(functions)
        raise InputError(f"{os.fspath(path)}: expected a name ending in {known}")
    return functions[suffix]
