"""Any table, by a map from quantities to the names of its columns."""

from collections.abc import Mapping
from typing import final

import numpy as np

from pinav.errors import InputError
from pinav.recordings import units
from pinav.recordings.formats.format import AbstractFormat
from pinav.recordings.rows import COMMAND_UNITS, Reading, Tracks
from pinav.recordings.source import Source

QUANTITIES = (
    "x",
    "y",
    "t",
    "frame",
    "particle",
    "run",
    "kind",
    "segment",
    *COMMAND_UNITS,
)
"""What a column may hold."""


@final
class MappedTable(AbstractFormat):
    """A CSV or parquet table whose columns the user names.

    Needed are x, y and one of t and frame. `units` states those that are not the
    usual ones: px, um, mm... for x (and y), s, ms... for t, deg for angles, rpm or
    rad/s for the frequency, % for fields.
    """

    name = "table"

    def suits(self, source: Source) -> bool:
        return False  # it is chosen by giving a column map

    def tracks(self, source: Source, reading: Reading) -> Tracks:
        columns = _checked(reading.columns or {}, reading.units or {})
        table = source.table()

        def numbers(name: str, *, lost: bool = True) -> np.ndarray | None:
            return table.numbers(columns[name], lost=lost) if name in columns else None

        def whole(name: str) -> np.ndarray | None:
            if name not in columns:
                return None
            return table.whole_numbers(columns[name], least=0)

        def words(name: str) -> list[str] | None:
            return table.labels(columns[name]) if name in columns else None

        stated = reading.units or {}
        return Tracks(
            x=table.numbers(columns["x"], lost=True),
            y=table.numbers(columns["y"], lost=True),
            place=table.row,
            particle=words("particle"),
            run=words("run"),
            kind=words("kind"),
            frame=whole("frame"),
            time=numbers("t", lost=False),
            segment=whole("segment"),
            commands={
                name: table.numbers(columns[name], lost=True)
                * units.command(name, unit, stated.get(name, unit))
                for name, unit in COMMAND_UNITS.items()
                if name in columns
            },
            length_unit="?",
            time_unit="?",
            columns={"time": columns.get("t", ""), "frame": columns.get("frame", "")},
            facts={"columns": dict(columns)},
        )


def _checked(columns: Mapping[str, str], stated: Mapping[str, str]) -> dict[str, str]:
    for given, what in ((columns, "columns"), (stated, "units")):
        for name in given:
            if name not in QUANTITIES:
                raise InputError(
                    f"{what}: {name!r} is no quantity; expected some of "
                    f"{', '.join(QUANTITIES)}"
                )
    missing = [name for name in ("x", "y") if name not in columns]
    missing += [] if {"t", "frame"} & set(columns) else ["t or frame"]
    if missing:
        raise InputError(
            f"columns: {', '.join(missing)} not named; expected columns such as "
            "{'t': 'Time', 'x': 'X', 'y': 'Y'}"
        )
    return dict(columns)
