"""Any table, by a map from quantities to the names of its columns."""

import re
from collections.abc import Mapping
from typing import final

import numpy as np

from pinav.errors import InputError
from pinav.recordings import units
from pinav.recordings.formats.column_doubts import (
    check_one_unit,
    doubts_of_columns,
    unread_particles,
)
from pinav.recordings.formats.format import AbstractFormat
from pinav.recordings.rows import COMMAND_UNITS, Reading, Tracks
from pinav.recordings.source import Source
from pinav.recordings.table import Table

QUANTITIES = (
    "x",
    "y",
    "z",
    "t",
    "dt",
    "frame",
    "particle",
    "run",
    "kind",
    "segment",
    *COMMAND_UNITS,
)
"""What a column may hold; dt is the interval of each frame."""

_STAR = "*"
"""Stands for the names of the particles in a table with columns for each of them."""


@final
class MappedTable(AbstractFormat):
    """A table whose columns the user names: text, workbook, parquet or array.

    Needed are x, y and one of t, dt and frame. Units are those of the headings, such as
    `x [mm]` or `t/ms`, or of a row below them; `units` stands above both: px, um, mm...
    for x (and y), s, ms... for t, deg for angles, rpm or rad/s for the frequency, % for
    fields. `x=x*` and `y=y*` name the columns x1, y1, x2, y2... of particles 1, 2...
    Columns of an array are called 0, 1, 2...
    """

    name = "table"

    def suits(self, source: Source) -> bool:
        return False  # it is chosen by giving a column map

    def tracks(self, source: Source, reading: Reading) -> Tracks:
        columns = _check_columns(reading.columns or {}, reading.units or {})
        whole_table = source.table()
        table, columns = long_table(whole_table, columns)
        units_of = _units(table, columns, reading)
        check_one_unit(units_of)

        def whole(name: str) -> np.ndarray | None:
            if name not in columns:
                return None
            return table.whole_numbers(columns[name], least=0)

        def words(name: str) -> list[str] | None:
            return table.labels(columns[name]) if name in columns else None

        x, y = (table.numbers(columns[name], lost=True) for name in "xy")
        particle = words("particle")
        time, time_unit = _times(table, columns, particle, units_of.get("t", ""))
        factor, length_unit = units.length(units_of.get("x"))
        commands = _commands(table, columns, units_of)
        return Tracks(
            x=factor * x,
            y=factor * y,
            z=factor * table.numbers(columns["z"], lost=True)
            if "z" in columns
            else None,
            place=table.row,
            particle=particle,
            run=words("run"),
            kind=words("kind"),
            frame=whole("frame"),
            time=time,
            segment=whole("segment"),
            commands=commands,
            length_unit=length_unit,
            time_unit=time_unit,
            columns={"time": columns.get("t", ""), "frame": columns.get("frame", "")},
            notes=(*table.notes, *unread_particles(whole_table, columns)),
            facts={"columns": dict(columns), "units of columns": dict(units_of)},
            doubts=doubts_of_columns(table, columns, units_of, reading, time, commands),
        )


def _units(
    table: Table, columns: Mapping[str, str], reading: Reading
) -> dict[str, str]:
    """Unit of each quantity: as the user states it, else as the table does."""
    stated = {name: table.unit(column) for name, column in columns.items()}
    # Positions and times that the user states are converted for every format alike.
    given = {n: u for n, u in (reading.units or {}).items() if n in COMMAND_UNITS}
    known = {name: unit for name, unit in {**stated, **given}.items() if unit}
    taken = {"x", "y"} if "x" in (reading.units or {}) else set()
    taken |= {"t", "dt"} if "t" in (reading.units or {}) else set()
    return {name: unit for name, unit in known.items() if name not in taken}


def _times(
    table: Table, columns: Mapping[str, str], particle: list[str] | None, unit: str
) -> tuple[np.ndarray | None, str]:
    """Times and their unit: of a column, or summed from the intervals of the frames."""
    if "t" in columns:
        times, clock = table.times(columns["t"])
        factor, known = units.duration(unit)
        return factor * times, clock or known
    if "dt" not in columns:
        return None, "?"
    steps = table.numbers(columns["dt"])
    factor, known = units.duration(table.unit(columns["dt"]))
    times = np.empty_like(steps)
    names = np.array(particle or [""] * len(steps), object)
    for name in dict.fromkeys(names):
        rows = np.flatnonzero(names == name)
        times[rows] = np.cumsum(steps[rows]) - steps[rows[0]]
    return factor * times, known


def _commands(
    table: Table, columns: Mapping[str, str], stated: Mapping[str, str]
) -> dict[str, np.ndarray]:
    return {
        name: table.numbers(columns[name], lost=True)
        * units.command(name, unit, stated.get(name, unit))
        for name, unit in COMMAND_UNITS.items()
        if name in columns
    }


def long_table(
    table: Table, columns: Mapping[str, str]
) -> tuple[Table, dict[str, str]]:
    """A table with columns for each particle as one with rows for each particle."""
    wide = {name: column for name, column in columns.items() if _STAR in column}
    if not wide:
        return table, dict(columns)
    if "particle" in columns or not {"x", "y"} <= set(wide):
        raise InputError(
            "columns: a star stands for the particles in x and y both, such as x=x* "
            "y=y*, and no column names them then"
        )
    names = [_particles(table, column) for column in wide.values()]
    particles = [name for name in names[0] if all(name in other for other in names[1:])]
    if not particles:
        raise InputError(
            f"{table.header}: no columns like {' and '.join(wide.values())}; got "
            f"{', '.join(table.columns)}"
        )
    shared = [columns[name] for name in columns if name not in wide]
    count = len(table)
    cells: dict[str, list] = {column: [] for column in (*shared, *wide.values())}
    for particle in particles:
        for column in shared:
            cells[column] += list(table.column(column))
        for column in wide.values():
            cells[column] += list(table.column(column.replace(_STAR, particle)))
    units_of = {c: table.unit(c) for c in shared}
    units_of |= {c: table.unit(c.replace(_STAR, particles[0])) for c in wide.values()}
    label = "particle of the columns"
    cells[label] = [name for name in particles for _ in range(count)]
    rows = np.tile(table.rows, len(particles))
    known = {name: unit for name, unit in units_of.items() if unit}
    long = Table(cells, rows, table.place, known, table.faults, table.notes)
    return long, {**columns, "particle": label}


def _particles(table: Table, pattern: str) -> list[str]:
    """What the star stands for in the headings that match a pattern."""
    before, after = (re.escape(part) for part in pattern.split(_STAR, 1))
    matches = (
        re.fullmatch(f"{before}(.+?){after}", units.split_heading(heading)[0])
        or re.fullmatch(f"{before}(.+?){after}", heading)
        for heading in table.columns
    )
    return [match[1] for match in matches if match]


def _check_columns(
    columns: Mapping[str, str], stated: Mapping[str, str]
) -> dict[str, str]:
    columns = dict(
        # 0=t says the same as t=0
        (column, name)
        if column in QUANTITIES and name not in QUANTITIES
        else (name, column)
        for name, column in columns.items()
    )
    for given, what in ((columns, "columns"), (stated, "units")):
        for name in given:
            if name not in QUANTITIES:
                raise InputError(
                    f"{what}: {name!r} is no quantity; expected some of "
                    f"{', '.join(QUANTITIES)}"
                )
    missing = [name for name in ("x", "y") if name not in columns]
    missing += [] if {"t", "dt", "frame"} & set(columns) else ["t or frame"]
    if missing:
        raise InputError(
            f"columns: {', '.join(missing)} not named; expected columns such as "
            "{'t': 'Time', 'x': 'X', 'y': 'Y'}"
        )
    return dict(columns)
