"""The tidy table: one row for each run, particle and frame, units in its names."""

from collections.abc import Mapping
from typing import final

import numpy as np

from pinav.errors import InputError
from pinav.recordings.formats.format import AbstractFormat
from pinav.recordings.rows import Reading, Tracks
from pinav.recordings.source import Source
from pinav.recordings.table import Table

COMMANDS: Mapping[str, str] = {
    "freq_hz": "frequency",
    "alpha_rad": "heading",
    "gamma_rad": "gamma",
    "psi_rad": "psi",
    "bx": "field_x",
    "by": "field_y",
    "bz": "field_z",
    "acoustic_hz": "acoustic_frequency",
}
"""Commands by the names of their columns."""


@final
class Tidy(AbstractFormat):
    """`t_s, x_um, y_um` (y up) or `x_px, y_px` (y down), and what else is known.

    Optional: `run, kind, particle, segment, frame` and the columns of `COMMANDS`.
    Micrometres are taken where there are any, unless `mpp` asks for pixels.
    """

    name = "tidy"

    def suits(self, source: Source) -> bool:
        names = set(source.column_names)
        return "t_s" in names and any(
            {f"x_{unit}", f"y_{unit}"} & names for unit in ("um", "px")
        )

    def tracks(self, source: Source, reading: Reading) -> Tracks:
        table = source.table()
        in_um = "x_um" in table.columns and not (
            reading.mpp and "x_px" in table.columns
        )
        unit = "um" if in_um else "px"
        if not {f"x_{unit}", f"y_{unit}"} & set(table.columns):
            raise InputError(
                "header: expected positions in columns x_um, y_um or x_px, y_px, got "
                f"{', '.join(table.columns)}; a log of commands alone is no recording"
            )
        return Tracks(
            x=table.numbers(f"x_{unit}", lost=True),
            y=table.numbers(f"y_{unit}", lost=True),
            place=table.row,
            particle=_labels(table, "particle"),
            run=_labels(table, "run"),
            kind=_labels(table, "kind"),
            frame=_whole(table, "frame"),
            time=table.numbers("t_s"),
            segment=_whole(table, "segment"),
            commands={
                name: table.numbers(column, lost=True)
                for column, name in COMMANDS.items()
                if column in table.columns
            },
            length_unit=unit,
            y_down=not in_um,
            columns={"time": "t_s"},
        )


def _labels(table: Table, name: str) -> list[str] | None:
    return table.labels(name) if name in table.columns else None


def _whole(table: Table, name: str) -> np.ndarray | None:
    return table.whole_numbers(name, least=0) if name in table.columns else None
