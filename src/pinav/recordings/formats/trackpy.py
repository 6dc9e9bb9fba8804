"""Tables of trackpy: `frame, particle, x, y` in pixels, y down."""

from typing import final

from pinav.errors import InputError
from pinav.recordings.formats.format import AbstractFormat
from pinav.recordings.rows import Reading, Tracks
from pinav.recordings.source import Source

_FEATURES = {"mass", "size", "ecc", "signal", "raw_mass", "ep"}
"""Columns of features that are found but not linked yet."""


@final
class Trackpy(AbstractFormat):
    """What `trackpy.link` returns, as CSV, parquet or DataFrame.

    Times need `fps`, micrometres `mpp`: names and meaning are those of trackpy.
    """

    name = "trackpy"

    def suits(self, source: Source) -> bool:
        names = set(source.column_names)
        linked = {"frame", "particle", "x", "y"} <= names
        return linked or ({"frame", "x", "y"} <= names and bool(names & _FEATURES))

    def tracks(self, source: Source, reading: Reading) -> Tracks:
        table = source.table()
        if "particle" not in table.columns:
            raise InputError(
                f"{table.header}: column 'particle' is missing; got "
                f"{', '.join(table.columns)}; link the features first (trackpy.link)"
            )
        return Tracks(
            x=table.numbers("x", lost=True),
            y=table.numbers("y", lost=True),
            place=table.row,
            particle=table.labels("particle"),
            frame=table.whole_numbers("frame", least=0),
            z=table.numbers("z", lost=True) if "z" in table.columns else None,
        )
