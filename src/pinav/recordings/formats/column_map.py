"""Any table, by a map from quantities to the names of its columns, and its doubts."""

import re
from collections.abc import Mapping
from typing import final

import numpy as np

from pinav.errors import InputError
from pinav.recordings import units
from pinav.recordings.conventions import TURNS
from pinav.recordings.rows import COMMAND_UNITS, Reading, Tracks, read_commands
from pinav.recordings.source import AbstractFormat, Source
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
"""Quantities of columns; dt is the interval of each frame."""

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

    def tracks(self, source: Source) -> Tracks:
        reading = source.reading
        columns = _check_columns(reading.columns or {}, reading.units or {})
        whole_table = source.table()
        table, columns = long_table(whole_table, columns)
        units_of = _units(table, columns, reading)
        check_one_unit(units_of)
        factor, length_unit = units.length(units_of.get("x"))
        time, time_unit = _times(table, columns, units_of.get("t", ""))
        commands = read_commands(table, columns, units_of)
        return Tracks.of_table(
            table,
            columns,
            scale=factor,
            time=time,
            commands=commands,
            length_unit=length_unit,
            time_unit=time_unit,
            notes=(*table.notes, *unread_particles(whole_table, columns)),
            facts={"columns": dict(columns), "units of columns": dict(units_of)},
            doubts=doubts_of_columns(table, columns, units_of, reading, time, commands),
        )


def _units(
    table: Table, columns: Mapping[str, str], reading: Reading
) -> dict[str, str]:
    stated = {name: table.unit(column) for name, column in columns.items()}
    # Positions and times that the user states are converted for every format alike.
    given = {n: u for n, u in (reading.units or {}).items() if n in COMMAND_UNITS}
    known = {name: unit for name, unit in {**stated, **given}.items() if unit}
    taken = {"x", "y"} if "x" in (reading.units or {}) else set()
    taken |= {"t", "dt"} if "t" in (reading.units or {}) else set()
    return {name: unit for name, unit in known.items() if name not in taken}


def _times(
    table: Table, columns: Mapping[str, str], unit: str
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
    words = [""] * len(steps)
    if "particle" in columns:
        words = table.labels(columns["particle"])
    names = np.array(words, object)
    for name in dict.fromkeys(words):
        rows = np.flatnonzero(names == name)
        times[rows] = np.cumsum(steps[rows]) - steps[rows[0]]
    return factor * times, known


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
    """Values of the star in the headings that match a pattern."""
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


USUAL = (1e-4, 1.0)
"""Times from row to row in seconds, of any camera; beyond, another unit is likely."""


def check_one_unit(units_of: Mapping[str, str]) -> None:
    """Refuse x and y in different units."""
    several = {name: units_of[name] for name in "xy" if name in units_of}
    if len({units.length(unit) for unit in several.values()}) > 1:
        stated = " and ".join(f"{name} in {unit}" for name, unit in several.items())
        raise InputError(
            f"columns: the headings state {stated}; write both in one unit, or state "
            "that of both by --units x=um"
        )


def doubts_of_columns(
    table: Table,
    columns: Mapping[str, str],
    units_of: Mapping[str, str],
    reading: Reading,
    time: np.ndarray | None,
    commands: Mapping[str, np.ndarray],
) -> dict[str, str]:
    """Doubts about a table that the user must settle, by quantity."""
    stated = {*(reading.units or {})}
    doubts = _of_foreign_units(table, columns, stated)
    if "t" in columns and time is not None and "t" not in stated | set(doubts):
        doubts |= _of_times(table, columns["t"], time, known="t" in units_of)
    turned = np.abs(commands.get("heading", np.zeros(1)))
    if "heading" not in units_of and np.nanmax(turned, initial=0.0) > TURNS:
        doubts["heading"] = (
            f"headings reach {np.nanmax(turned):.4g}, and no unit is stated: state "
            "--units heading=deg, or heading=rad where turns are counted on"
        )
    return doubts


def _of_times(
    table: Table, column: str, time: np.ndarray, *, known: bool
) -> dict[str, str]:
    """Frames in place of times, and times in an unlikely unit."""
    steps = np.diff(np.unique(time[np.isfinite(time)]))
    if not len(steps) or table.times(column)[1]:  # stamps of a clock are seconds
        return {}
    if np.array_equal(steps, np.round(steps)) and steps.min() == 1:
        return {
            "t": "the times are whole numbers that count by one, as frames do: name "
            "their column as frame and give --fps, or state --units t=s"
        }
    step = float(np.median(steps))
    if known or USUAL[0] <= step <= USUAL[1]:
        return {}
    return {
        "t": f"the times advance by {step:.3g} from row to row, and no unit is stated: "
        "state --units t=ms, or t=s where they are seconds"
    }


_BRACKETS = re.compile(r"[^\[\]]*\[([^\[\]]+)\]\s*")


def _of_foreign_units(
    table: Table, columns: Mapping[str, str], stated: set[str]
) -> dict[str, str]:
    """Units in square brackets that are none of a quantity that was named."""
    doubts = {}
    defaults = {"x": "um", "t": "s", **COMMAND_UNITS}  # y has the unit of x
    for name in sorted(defaults.keys() & columns.keys() - stated):
        match = _BRACKETS.fullmatch(columns[name])
        if match and not table.unit(columns[name]):
            doubts[name] = (
                f"the unit {match[1]} of {columns[name]!r} is none of {name}: state "
                f"--units {name}={defaults[name]}, or name another column"
            )
    return doubts


def unread_particles(table: Table, columns: Mapping[str, str]) -> list[str]:
    """Sentences on columns of further particles that the column map does not name."""
    patterns = [_number_pattern(columns[name]) for name in "xy"]
    others = [
        [h for h in map(str, table.columns) if pattern.fullmatch(h)] if pattern else []
        for pattern in patterns
    ]
    if any("*" in columns[name] for name in "xy"):
        short = [len(names) for names in others]
        if short[0] == short[1]:
            return []
        return [
            f"{short[0]} columns like {columns['x']} and {short[1]} like "
            f"{columns['y']}: those without a partner are left out"
        ]
    if len(others[0]) < 2 or len(others[1]) < 2:
        return []
    x, y = (re.sub(r"\d+", "*", columns[name], count=1) for name in "xy")
    return [
        f"of {', '.join(others[0])} only {columns['x']} is read: x={x} y={y} reads the "
        "columns of all particles"
    ]


def _number_pattern(column: str) -> re.Pattern[str] | None:
    """Columns that differ from this one in a number, or match its star."""
    place = re.search(r"\*|\d+", column)
    if place is None or column.isdigit():  # the number of a column without a name
        return None
    before, after = column[: place.start()], column[place.end() :]
    return re.compile(f"{re.escape(before)}\\d+{re.escape(after)}")
