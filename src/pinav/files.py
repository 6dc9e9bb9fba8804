"""Files that are either whole or absent, whatever happens while they are written."""

import csv
import io
import os
import re
import secrets
import tomllib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import msgspec

from pinav.errors import InputError

UNREADABLE = OSError, UnicodeDecodeError, msgspec.DecodeError
"""What is raised where a JSON file is missing or damaged."""


def atomic_write(
    path: str | os.PathLike[str],
    write: Callable[[BinaryIO], object],
    *,
    overwrite: bool = False,
) -> None:
    """Write a file under a temporary name beside `path`, then rename it.

    A reader sees the old file or the new one, never a part. Whatever goes wrong, the
    old file stays and the temporary one is removed.

    Args:
        path: where the file goes; its folder must exist.
        write: writes the content to an open binary file.
        overwrite: replace a file that is there already.

    Raises:
        InputError: the file exists and `overwrite` is false, or the system refused
            to write (no such folder, no permission, disk full).
    """
    path = Path(path)
    check_destination(path, overwrite=overwrite)
    try:
        write_whole(path, write)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"{path}: cannot write: {reason}") from error


def csv_text(rows: Iterable[Sequence[Any]]) -> str:
    """Rows as CSV; a number that is not defined leaves its cell empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([None if cell != cell else cell for cell in row] for row in rows)
    return text.getvalue()


def check_destination(path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Refuse a file that `atomic_write` would refuse, before the work that fills it.

    Raises:
        InputError: it is a folder, it exists and `overwrite` is false, or there is no
            folder for it.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: expected the name of a file, got a folder")
    if path.exists() and not overwrite:
        raise InputError(
            f"{path}: exists already; choose another name, or replace it by "
            "--overwrite (in Python by overwrite=True)"
        )
    if not path.absolute().parent.is_dir():
        raise InputError(
            f"{path}: cannot write: no folder {path.parent}; make it first"
        )


def write_whole(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Write or replace a file as `atomic_write` does, with the system's own errors.

    Raises:
        OSError: the system refused to write; the old file stays.
    """
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    try:
        with open(temporary, "xb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def is_temporary(path: Path) -> bool:
    """The name is one that `write_whole` gives a file while it is written."""
    return re.fullmatch(r"\..+\.[0-9a-f]{8}\.tmp", path.name) is not None


def append_line(path: Path, line: bytes) -> None:
    """Append a line to a file, after the end of one that a kill has cut off."""
    with open(path, "a+b") as file:
        if file.tell():
            file.seek(-1, io.SEEK_END)
            if file.read(1) != b"\n":
                file.write(b"\n")
        file.write(line + b"\n")


def check_regular(path: str | os.PathLike[str]) -> None:
    """Refuse a pipe or a device, of which reading may never end.

    Raises:
        InputError: it is one.
    """
    path = Path(path)
    if path.exists() and not (path.is_file() or path.is_dir()):
        kind = "a pipe" if path.is_fifo() else "a device"
        raise InputError(f"expected a file, got {kind}; save the data to a file first")


def read_toml(path: Path, name: str = "") -> dict[str, Any]:
    """The content of a TOML file, which messages call by its path unless it is named.

    Raises:
        InputError: it cannot be read.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{name or path}: cannot be read: {error}") from error


def write_text(
    path: str | os.PathLike[str], text: str, *, overwrite: bool = False
) -> None:
    """Write UTF-8 text as `atomic_write` does, with its errors."""
    atomic_write(path, lambda file: file.write(text.encode()), overwrite=overwrite)
