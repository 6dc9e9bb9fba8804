"""What nobody states of mapped columns, and what looks like something else."""

import re
from collections.abc import Mapping

import numpy as np

from pinav.errors import InputError
from pinav.recordings import units
from pinav.recordings.conventions import TURNS
from pinav.recordings.rows import COMMAND_UNITS, Reading
from pinav.recordings.table import Table

USUAL = (1e-4, 1.0)
"""Times from row to row in seconds, of any camera; beyond, another unit is likely."""


def check_one_unit(units_of: Mapping[str, str]) -> None:
    """Refuse x and y in different units.

    Raises:
        InputError: they differ, and `units` does not settle both.
    """
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
    """What a fit must not take for granted, by the quantity that it is about.

    Args:
        table: with a row for each position.
        columns: its column of each quantity.
        units_of: unit of each quantity, where one is known.
        reading: what the user states.
        time: of each row, in s where its unit is known.
        commands: of each row, in the units of pinav.
    """
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
    """Columns of further particles that the column map does not name, in words.

    Args:
        table: as the file has it.
        columns: names of the quantities, perhaps with stars.
    """
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
