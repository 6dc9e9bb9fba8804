"""Trajectories as text: one sample a row, a first line for what columns cannot say."""

import csv
import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO, NamedTuple

import msgspec
import numpy as np

from pinav.errors import InputError
from pinav.files import csv_text
from pinav.trajectories.npz_files import Metadata, metadata_text, parse_metadata
from pinav.trajectories.trajectories import Trajectories
from pinav.trajectories.trajectory import check_increasing, split_headings

PREFIX = "# pinav:"


def delimiter_of(header: str) -> str:
    """Delimiter of the cells: a comma, or else a semicolon."""
    return ";" if ";" in header and "," not in header else ","


def write_csv(trajectories: Trajectories, file: BinaryIO) -> None:
    """Write trajectories as text."""
    table = trajectories.to_table()
    text = csv_text([list(table), *zip(*table.values(), strict=True)])
    file.write(f"{PREFIX} {metadata_text(trajectories)}\n{text}".encode())


class _Row(NamedTuple):
    line: int
    cells: dict[str, str]


def read_csv(file: BinaryIO) -> Trajectories:
    """Read trajectories from text."""
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
    several = list(groups.values())
    states = [_numbers(group, metadata.channels, lost=True) for group in several]
    commands = [_numbers(group, metadata.commands) for group in several]
    return Trajectories.from_arrays(
        list(map(_times, several)),
        states,
        observed=list(map(np.isfinite, states)),
        commands={
            name: [values[:, column] for values in commands]
            for column, name in enumerate(metadata.commands)
        },
        channels=metadata.channels,
        units=metadata.units,
        provenance={"source": Path(file.name).name}
        if metadata.provenance is None
        else metadata.provenance,
    )


def _leading_comments(lines: Sequence[str]) -> tuple[int, Metadata]:
    """Number of lines above the header, and the metadata among them."""
    metadata = Metadata()
    for index, line in enumerate(lines):
        if not line.startswith("#"):
            return index, metadata
        if line.startswith(PREFIX):
            metadata = parse_metadata(f"line {index + 1}", line[len(PREFIX) :])
    return len(lines), metadata


def _table(
    lines: Sequence[str], num_comments: int, metadata: Metadata
) -> tuple[Metadata, list[_Row]]:
    # A file of ours says its channels, whose names may hold semicolons and brackets.
    plain = not metadata.channels
    first = lines[num_comments] if plain and num_comments < len(lines) else ""
    delimiter = delimiter_of(first)
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
    place: str, header: Sequence[str], metadata: Metadata
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
    times = _numbers(rows, ("t",))[:, 0]
    check_increasing(times, lambda index: f"line {rows[index].line}, column t")
    return times


def _numbers(
    rows: Sequence[_Row], names: Sequence[str], *, lost: bool = False
) -> np.ndarray:
    """Columns of numbers; where they may be lost, an empty cell is one that is."""
    cells = [[_number(row, name, lost=lost) for name in names] for row in rows]
    return np.array(cells, np.float64)


def _number(row: _Row, column: str, *, lost: bool) -> float:
    text = row.cells[column].strip()
    if lost and not text:
        return math.nan
    try:
        number = math.nan if "_" in text else float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        remedy = "leave the cell empty to mark a missing observation"
        raise InputError(
            f"line {row.line}, column {column}: expected a finite number, "
            f"got {text!r}; {remedy if lost else 'give its value'}"
        )
    return number
