"""Trajectories on disk: `.npz` for machines, `.csv` for everything else.

A CSV file has the columns `t` and one for each channel, and `trajectory` where it
holds several. An empty cell is a missing observation, and a heading may state a unit:
`x [um]`. Columns are separated by commas, or by semicolons, with decimal points or
decimal commas. What the columns cannot say stands in a first line `# pinav: {...}`, all
of whose entries are optional: `channels`, `commands` (names of columns that are
commands), `units`, `provenance`.
"""

import csv
import dataclasses
import io
import json
import math
import os
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, TypeVar

import msgspec
import numpy as np

from pinav.errors import InputError
from pinav.files import atomic_write, check_regular
from pinav.trajectories.tables import split_headings
from pinav.trajectories.trajectories import Trajectories
from pinav.trajectories.trajectory import check_increasing

Function = TypeVar("Function", bound=Callable)

FORMAT = 1
"""Version of both formats; a newer one is refused."""

PREFIX = "# pinav:"


def save(
    trajectories: Trajectories, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write trajectories to a `.npz` or `.csv` file; either keeps every digit.

    Args:
        trajectories: what to write.
        path: the suffix chooses the format.
        overwrite: replace a file that is there already.

    Raises:
        InputError: the suffix is another, the file exists and `overwrite` is false,
            or the file cannot be written; then nothing of it is left behind.
    """
    write = _by_suffix(path, {".npz": _write_npz, ".csv": _write_csv})
    atomic_write(path, lambda file: write(trajectories, file), overwrite=overwrite)


def load(
    path: str | os.PathLike[str], *, units: Mapping[str, str] | None = None
) -> Trajectories:
    """Read trajectories from a `.npz` or `.csv` file; nothing in it is executed.

    Args:
        path: the suffix tells the format.
        units: unit of any channel, command or `t`, in place of what the file says.

    Raises:
        InputError: the file cannot be read, or is not what its suffix says; the
            message names the file and the place in it.
    """
    read = _by_suffix(path, {".npz": _read_npz, ".csv": _read_csv})
    try:
        check_regular(path)
        with open(path, "rb") as file:
            return _with_units(read(file), units or {})
    except InputError as error:
        raise InputError(f"{os.fspath(path)}: {error}") from error
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"{os.fspath(path)}: cannot read: {reason}") from error


def _with_units(trajectories: Trajectories, units: Mapping[str, str]) -> Trajectories:
    for name in units:
        if name not in trajectories.units:
            raise InputError(
                f"units: {name!r} is no column; expected some of "
                f"{', '.join(trajectories.units)}"
            )
    return dataclasses.replace(trajectories, units={**trajectories.units, **units})


def is_trajectories(path: str | os.PathLike[str]) -> bool:
    """Whether a file looks as `save` writes it: `.npz`, or a CSV with a column t.

    What cannot be opened counts as one, so that `load` says why.
    """
    suffix = Path(path).suffix.lower()
    if suffix != ".csv":
        return suffix == ".npz"
    try:
        check_regular(path)
        with open(path, encoding="utf-8-sig", errors="replace") as file:
            first = file.readline()
    except (OSError, InputError):
        return True
    names, _ = split_headings(first.split(_delimiter(first)))
    return first.startswith(PREFIX) or "t" in names


def _delimiter(header: str) -> str:
    """What separates the cells: a comma, or a semicolon where there is no comma."""
    return ";" if ";" in header and "," not in header else ","


def _by_suffix(
    path: str | os.PathLike[str], functions: dict[str, Function]
) -> Function:
    suffix = Path(path).suffix.lower()
    if suffix not in functions:
        known = " or ".join(functions)
        raise InputError(f"{os.fspath(path)}: expected a name ending in {known}")
    return functions[suffix]


class _Metadata(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the numbers do not say."""

    format: int = FORMAT
    channels: tuple[str, ...] = ()
    commands: tuple[str, ...] = ()
    units: dict[str, str] = {}
    provenance: dict[str, Any] | None = None


def _metadata_text(trajectories: Trajectories) -> str:
    metadata = _Metadata(
        channels=trajectories.channels,
        commands=tuple(trajectories.commands),
        units=trajectories.units,
        provenance=trajectories.provenance,
    )
    return json.dumps(msgspec.structs.asdict(metadata))


def _parse_metadata(place: str, text: str) -> _Metadata:
    try:
        values = json.loads(text)
        version = values.get("format", FORMAT) if isinstance(values, dict) else FORMAT
        if version != FORMAT:
            raise InputError(
                f"{place}: format {version!r} is not known, expected {FORMAT}; "
                "read it with the version of pinav that wrote it"
            )
        return msgspec.convert(values, _Metadata)
    except (json.JSONDecodeError, msgspec.ValidationError) as error:
        raise InputError(f"{place}: not the metadata of pinav: {error}") from error


_ARRAYS = {"times": 1, "states": 2, "observed": 2, "commands": 2, "lengths": 1}
"""Arrays of the npz format and their axes; samples of all trajectories in one row."""


def _write_npz(trajectories: Trajectories, file: BinaryIO) -> None:
    pieces = list(trajectories)
    commands = [np.stack([*piece.commands.values(), piece.times]) for piece in pieces]
    np.savez(
        file,
        metadata=np.array(_metadata_text(trajectories)),
        times=np.concatenate([piece.times for piece in pieces]),
        states=np.concatenate([piece.states for piece in pieces]),
        observed=np.concatenate([piece.observed for piece in pieces]),
        commands=np.concatenate(commands, axis=1)[:-1],
        lengths=trajectories.lengths,
    )


def _read_npz(file: BinaryIO) -> Trajectories:
    if not zipfile.is_zipfile(file):
        raise InputError("not an npz file, or one cut short; write it again")
    try:
        _check_sizes(file)
        file.seek(0)
        with np.load(file, allow_pickle=False) as archive:
            arrays = {name: np.asarray(archive[name]) for name in archive.files}
    except InputError:
        raise
    except (ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(f"damaged npz file: {error}") from error
    expected = ("metadata", *_ARRAYS)
    for name in expected:
        if name not in arrays:
            raise InputError(
                f"array {name!r} is missing; expected {', '.join(expected)}, "
                f"got {', '.join(arrays) or 'none'}"
            )
    metadata = _parse_metadata("array 'metadata'", str(arrays["metadata"]))
    for name, ndim in _ARRAYS.items():
        if arrays[name].ndim != ndim:
            shape = arrays[name].shape
            raise InputError(f"array {name!r}: expected {ndim} axes, got shape {shape}")
    return _from_flat(arrays, metadata)


MAX_BYTES, MAX_RATIO = 2**33, 200
"""Size of an npz file's arrays, and how much larger than the file large ones may be."""


def _check_sizes(file: BinaryIO) -> None:
    """Refuse arrays that are not there, before memory is asked for them.

    A header may claim any number of values, and a few kilobytes may unpack to more than
    the memory holds.
    """
    file.seek(0)
    with zipfile.ZipFile(file) as archive:
        members = archive.infolist()
        total = sum(member.file_size for member in members)
        packed = sum(member.compress_size for member in members)
        if total > MAX_BYTES or (total > 2**27 and total > MAX_RATIO * packed):
            raise InputError(
                f"npz file of {packed} bytes that unpacks to {total}; expected the "
                "file of an experiment, at most 8 GiB"
            )
        for member in members:
            with archive.open(member) as stream:
                version = np.lib.format.read_magic(stream)
                read = np.lib.format.read_array_header_1_0
                if version != (1, 0):
                    read = np.lib.format.read_array_header_2_0
                shape, _, dtype = read(stream)
                claimed = math.prod(shape) * dtype.itemsize
                if claimed > member.file_size:
                    raise InputError(
                        f"array {member.filename!r} claims {claimed} bytes, but the "
                        f"file holds {member.file_size}; write it again"
                    )


def _from_flat(arrays: dict[str, np.ndarray], metadata: _Metadata) -> Trajectories:
    lengths, count = arrays["lengths"], len(arrays["times"])
    if lengths.dtype.kind not in "iu" or (lengths < 0).any() or lengths.sum() != count:
        raise InputError(
            f"array 'lengths': expected whole numbers that add up to the {count} "
            f"times, got {lengths.tolist()}"
        )
    for name in ("states", "observed", "commands"):
        samples = arrays[name].shape[1 if name == "commands" else 0]
        if samples != count:
            raise InputError(f"array {name!r}: expected {count} samples, got {samples}")
    commands = arrays["commands"]
    if len(commands) != len(metadata.commands):
        raise InputError(
            f"array 'commands': expected {len(metadata.commands)} rows "
            f"({', '.join(metadata.commands)}), got {len(commands)}"
        )
    ends = np.cumsum(lengths)[:-1]
    return Trajectories.from_arrays(
        np.split(arrays["times"], ends),
        np.split(arrays["states"], ends),
        observed=np.split(arrays["observed"], ends),
        commands={
            name: np.split(values, ends)
            for name, values in zip(metadata.commands, commands, strict=True)
        },
        channels=metadata.channels,
        units=metadata.units,
        provenance=metadata.provenance,
    )


def _write_csv(trajectories: Trajectories, file: BinaryIO) -> None:
    text = io.TextIOWrapper(file, encoding="utf-8", newline="")
    text.write(f"{PREFIX} {_metadata_text(trajectories)}\n")
    writer = csv.writer(text, lineterminator="\n")
    names = (*trajectories.channels, *trajectories.commands)
    writer.writerow(("trajectory", "t", *names))
    for index, piece in enumerate(trajectories):
        cells = np.where(piece.observed, piece.states.astype(object), "")
        columns = (*cells.T, *piece.commands.values())
        for row in zip(piece.times, *columns, strict=True):
            writer.writerow((index, *(_cell(value) for value in row)))
    text.flush()
    text.detach()


def _cell(value: Any) -> str:
    return value if isinstance(value, str) else repr(float(value))


class _Row(NamedTuple):
    line: int
    cells: dict[str, str]


def _read_csv(file: BinaryIO) -> Trajectories:
    try:
        text = file.read().decode("utf-8-sig")  # spreadsheets put a mark before it
        lines = io.StringIO(text, newline="").readlines()
        num_comments, metadata = _leading_comments(lines)
        metadata, rows = _table(lines, num_comments, metadata)
    except UnicodeDecodeError as error:
        raise InputError(f"expected UTF-8 text: {error}; save it as such") from error
    except csv.Error as error:
        raise InputError(f"not a CSV file: {error}") from error
    groups: dict[str, list[_Row]] = {}
    for row in rows:
        groups.setdefault(row.cells.get("trajectory", ""), []).append(row)
    if not groups:
        raise InputError("no rows below the header; expected two or more samples")
    tables = [_observations(group, metadata.channels) for group in groups.values()]
    return Trajectories.from_arrays(
        [_times(group) for group in groups.values()],
        [states for states, _ in tables],
        observed=[observed for _, observed in tables],
        commands={
            name: [_column(group, name) for group in groups.values()]
            for name in metadata.commands
        },
        channels=metadata.channels,
        units=metadata.units,
        provenance={"source": Path(file.name).name}
        if metadata.provenance is None
        else metadata.provenance,
    )


def _leading_comments(lines: Sequence[str]) -> tuple[int, _Metadata]:
    """How many lines precede the header, and the metadata among them."""
    metadata = _Metadata()
    for index, line in enumerate(lines):
        if not line.startswith("#"):
            return index, metadata
        if line.startswith(PREFIX):
            metadata = _parse_metadata(f"line {index + 1}", line[len(PREFIX) :])
    return len(lines), metadata


def _table(
    lines: Sequence[str], num_comments: int, metadata: _Metadata
) -> tuple[_Metadata, list[_Row]]:
    """The rows by column name, and the metadata with the channels filled in."""
    # A file of ours says its channels, whose names may hold semicolons and brackets.
    plain = not metadata.channels
    first = lines[num_comments] if plain and num_comments < len(lines) else ""
    delimiter = _delimiter(first)
    reader = csv.reader(lines[num_comments:], strict=True, delimiter=delimiter)
    header = [name.strip() for name in next(reader, [])]
    units = metadata.units
    if plain:
        header, stated = split_headings(header)
        units = {**stated, **units}
    place = f"line {num_comments + 1}"
    channels = _check_header(place, header, metadata)
    rows = []
    for cells in reader:
        line = num_comments + reader.line_num
        if cells and len(cells) != len(header):
            raise InputError(
                f"line {line}: expected {len(header)} cells "
                f"({', '.join(header)}), got {len(cells)}"
            )
        if delimiter == ";":
            cells = [cell.replace(",", ".") for cell in cells]
        if cells:
            rows.append(_Row(line, dict(zip(header, cells, strict=True))))
    return msgspec.structs.replace(metadata, channels=channels, units=units), rows


def _check_header(
    place: str, header: Sequence[str], metadata: _Metadata
) -> tuple[str, ...]:
    """The channels among the columns, in the order of the metadata if it has one."""
    got = ", ".join(header) or "nothing"
    for name in header:
        if header.count(name) > 1:
            raise InputError(f"{place}: column {name!r} stands twice in {got}")
    others = ("trajectory", "t", *metadata.commands)
    channels = metadata.channels or tuple(n for n in header if n not in others)
    needed = ("t", *channels, *metadata.commands)
    if not channels or set(header) | {"trajectory"} != {*needed, "trajectory"}:
        expected = ", ".join(needed if metadata.channels else ("t", "x", "y", "..."))
        raise InputError(
            f"{place}: expected the columns {expected}, got {got}; the first line "
            "names the columns, separated by commas"
        )
    return channels


def _times(rows: Sequence[_Row]) -> np.ndarray:
    times = _column(rows, "t")
    check_increasing(times, lambda index: f"line {rows[index].line}, column t")
    return times


def _column(rows: Sequence[_Row], name: str) -> np.ndarray:
    numbers = [_number(row, name, "give its value") for row in rows]
    return np.array(numbers, np.float64)


def _observations(
    rows: Sequence[_Row], channels: Sequence[str]
) -> tuple[np.ndarray, np.ndarray]:
    """States and mask; an empty cell is a missing observation."""
    observed = np.array(
        [[bool(row.cells[c].strip()) for c in channels] for row in rows]
    )
    remedy = "leave the cell empty to mark a missing observation"
    states = [
        [_number(row, c, remedy) if row.cells[c].strip() else 0.0 for c in channels]
        for row in rows
    ]
    return np.array(states, np.float64), observed


def _number(row: _Row, column: str, remedy: str) -> float:
    text = row.cells[column].strip()
    try:
        number = math.nan if "_" in text else float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise InputError(
            f"line {row.line}, column {column}: expected a finite number, "
            f"got {text!r}; {remedy}"
        )
    return number
