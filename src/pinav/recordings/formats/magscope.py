"""Workbooks of MagScope: what the coils did in one sheet, each robot in another."""

import dataclasses
import io
import re
import zipfile
import zlib
from typing import Any, final

import numpy as np
from jaxtyping import Float64

from pinav.errors import InputError
from pinav.recordings import units
from pinav.recordings.layout import read_sheets, table_of
from pinav.recordings.rows import Reading, Tracks, read_commands
from pinav.recordings.source import AbstractFormat, Source
from pinav.recordings.table import Table

ACTIONS = "Magnetic Field Actions"
_ROBOT = re.compile(r"Robot (\d+)$")
_UNIT = re.compile(r"\s*\(([^)]*)\)$")
_COMMANDS = {
    "Rolling Frequency": "frequency",
    "Alpha": "heading",
    "Gamma": "gamma",
    "Psi": "psi",
    "Bx": "field_x",
    "By": "field_y",
    "Bz": "field_z",
    "Acoustic Frequency": "acoustic_frequency",
}


@final
class MagScope(AbstractFormat):
    """The three dialects of the recorder, told apart by the units in their headers.

    2024: `Times` is the interval of each frame, positions in px. 2024-12 and 2025:
    `Time(s)` is the time, positions in px or in um. Commands are joined on the frame
    number, because either sheet may repeat and drop rows; a frame without one keeps
    the last. Logged velocities are filtered online and change their unit from version
    to version: they are not read. Nor are the sensor columns, which hold placeholders.
    """

    name = "magscope"

    def suits(self, source: Source) -> bool:
        return source.kind == "workbook" and _is_recorders(source.content)

    def tracks(self, source: Source) -> Tracks:
        rows = read_sheets(source.content)
        sheets = {
            name: _table(name, cells, source.faults)
            for name, cells in rows.items()
            if name == ACTIONS or _ROBOT.match(name)
        }
        robots = {
            match[1]: _robot(table)
            for name, table in sheets.items()
            if (match := _ROBOT.match(name))
        }
        if not robots:
            raise InputError(
                f"sheets {', '.join(rows)}: expected 'Robot 1' and so on; is it a "
                "MagScope workbook? Of any other, name a sheet and its columns"
            )
        tables = list(robots.values())
        unit = _length_unit(tables)
        scale, scale_notes = _scale(tables, unit, source.reading)
        whole = Table.concatenate([_named(table) for table in tables])
        clocks = [_times(table) for table in tables]
        frame = whole.whole_numbers("Frame", least=0)
        commands, notes = _commands(sheets, frame)
        return Tracks.of_table(
            whole,
            {
                "x": "Pos X",
                "y": "Pos Y",
                "frame": "Frame",
                "t": tables[0].resolve(_clock(tables[0])),
            },
            scale=scale,
            particle=[number for number, t in robots.items() for _ in range(len(t))],
            frame=frame,
            time=np.concatenate([times for times, _ in clocks]),
            commands=commands,
            length_unit="um" if scale_notes else unit,
            notes=(*notes, *scale_notes, *(n for _, said in clocks for n in said)),
        )


def _is_recorders(content: bytes) -> bool:
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            book = archive.read("xl/workbook.xml").decode("utf-8", "replace")
    except (zipfile.BadZipFile, KeyError, OSError, EOFError, zlib.error):
        return False
    names = re.findall(r'<(?:\w+:)?sheet [^>]*name="([^"]*)"', book)
    return any(name == ACTIONS or _ROBOT.match(name) for name in names)


def _table(
    name: str, rows: list[tuple[Any, ...]], faults: dict[str, str] | None
) -> Table:
    """One sheet; rows that hold no frame, but the path that was drawn, are skipped."""
    place = f"sheet {name!r}"
    header = [str(cell or "").strip() for cell in rows[0]] if rows else []
    if "Frame" not in header:
        raise InputError(
            f"{place}, row 1: column 'Frame' is missing; got "
            f"{', '.join(filter(None, header)) or 'nothing'}; is it a MagScope "
            "workbook?"
        )
    width = len(header)
    body = [(i, (*row, *[None] * width)[:width]) for i, row in enumerate(rows[1:], 2)]
    drawn = [k for k, name in enumerate(header) if name.startswith("Path ")]
    body = [
        (i, row)
        for i, row in body
        if any(c is not None for k, c in enumerate(row) if k not in drawn)
    ]
    if not body:
        raise InputError(f"{place}: no rows below the header; record it again")
    return table_of([(1, header), *body], f"{place}, row", faults=faults)


def _robot(table: Table) -> Table:
    """A robot's sheet without exact repeats of a row."""
    cells = list(zip(*_named(table).columns.values(), strict=True))
    again = [i > 0 and row == cells[i - 1] for i, row in enumerate(cells)]
    return table.select(~np.array(again))


def _named(table: Table) -> Table:
    """Frame and position of a robot, without the units in their headings."""
    columns = {name: table.column(name) for name in ("Frame", "Pos X", "Pos Y")}
    return dataclasses.replace(table, columns=columns)


def _clock(table: Table) -> str:
    """The column of times, or of the intervals of the frames."""
    return "Times" if "Times" in table.columns else "Time"


def _length_unit(tables: list[Table]) -> str:
    """Unit of the positions, which all sheets share; px where none is written."""
    words = {table.unit("Pos X") for table in tables}
    if len(words) > 1:
        raise InputError(
            f"sheets 'Robot ...': positions in {' and '.join(sorted(words))}; bring "
            "them to one unit"
        )
    word = words.pop()
    return units.length(word)[1] if word else "px"


def _scale(
    tables: list[Table], unit: str, reading: Reading
) -> tuple[float, tuple[str, ...]]:
    """Factor to um from the column that some versions log, and a note of it."""
    known = [t.numbers("pix2metric") for t in tables if "pix2metric" in t.columns]
    if unit != "px" or reading.mpp is not None or not known:
        return 1.0, ()
    per_um = np.unique(np.concatenate(known))
    if len(per_um) != 1 or per_um[0] <= 0:
        raise InputError(
            f"{tables[0].header}, column 'pix2metric': expected one number > 0, got "
            f"{per_um.tolist()}; give mpp"
        )
    scale = 1.0 / float(per_um[0])
    return scale, (f"scale {scale:.4g} um/px from the column pix2metric",)


def _times(table: Table) -> tuple[Float64[np.ndarray, " row"], tuple[str, ...]]:
    """Times of a robot's rows [s]: as they are, or from the intervals of the frames."""
    column = table.resolve(_clock(table))
    values = table.numbers(column)
    notes: tuple[str, ...] = ()
    if column != "Times":
        if not _are_intervals(values):
            return values, ()
        notes = (f"{column} of {table.header} holds intervals: they were added up",)
    for row in np.flatnonzero(values < 0).tolist():
        table.refuse(
            row,
            f"{table.where(row, column)}: expected the interval of a frame >= 0, got "
            f"{values[row]:g}; correct the cell",
        )
    values = np.nan_to_num(np.maximum(values, 0.0))
    return np.cumsum(values) - values[0], notes


LONGEST = 5.0
"""Frames further apart than this are not taken for intervals of a film [s]."""


def _are_intervals(values: np.ndarray) -> bool:
    """True if times that should increase are intervals, as in some versions."""
    known = values[np.isfinite(values)]
    if len(known) < 3 or known.min() < 0 or known.max() > LONGEST:
        return False
    return bool(np.mean(np.diff(known) <= 0) > 0.2)


def _commands(
    sheets: dict[str, Table], frame: np.ndarray
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Commands at each frame, NaN where the log says nothing."""
    if ACTIONS not in sheets:
        return {}, (f"no sheet {ACTIONS!r}: the recording has no commands",)
    table = sheets[ACTIONS]
    logged = table.whole_numbers("Frame", least=0)
    order = np.argsort(logged, kind="stable")
    index = np.searchsorted(logged[order], frame, "right") - 1
    row = order[np.maximum(index, 0)]
    known = (index >= 0) & (logged[row] == frame)
    columns = {_UNIT.sub("", column): column for column in table.columns}
    named = {name: columns[word] for word, name in _COMMANDS.items() if word in columns}
    stated = {n: match[1] for n, c in named.items() if (match := _UNIT.search(c))}
    commands = {
        name: np.where(known, values[row], np.nan)
        for name, values in read_commands(table, named, stated).items()
    }
    missing = int((~known).sum())
    if missing == len(frame):
        raise InputError(
            f"{table.header}: its frames, {logged.min()} to {logged.max()}, meet none "
            f"of the robots', {frame.min()} to {frame.max()}: the commands are not "
            "known; correct the frames, or delete the sheet"
        )
    notes = (f"{missing} rows without an action of their frame keep the last one",)
    return commands, notes if missing else ()
