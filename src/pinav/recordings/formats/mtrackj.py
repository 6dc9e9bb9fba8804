"""MTrackJ: tracks drawn by hand, as text."""

from collections.abc import Sequence
from typing import final

import numpy as np

from pinav.errors import InputError
from pinav.recordings.formats.format import AbstractFormat
from pinav.recordings.rows import Reading, Tracks
from pinav.recordings.source import Source
from pinav.recordings.table import Table

_TITLE = "MTrackJ"
_NAMES = ("x", "y", "z", "frame")


@final
class MTrackJ(AbstractFormat):
    """Lines `Assembly`, `Cluster`, `Track` and `Point index x y z frame channel`.

    The file does not say whether positions are pixels or calibrated: state
    `units={"x": "px"}` or give `mpp`. y is down; z is kept where it varies.
    """

    name = "mtrackj"

    def suits(self, source: Source) -> bool:
        return bool(source.first_lines) and source.first_lines[0].startswith(_TITLE)

    def tracks(self, source: Source, reading: Reading) -> Tracks:
        cluster, track = "1", "1"
        names: list[str] = []
        lines: list[int] = []
        cells: list[list[str]] = []
        for line, text in enumerate(source.text.splitlines(), start=1):
            words = text.split()
            kind = words[0] if words else ""
            if kind == "Cluster" and len(words) > 1:
                cluster = words[1]
            elif kind == "Track" and len(words) > 1:
                track = words[1]
            elif kind == "Point":
                if len(words) < 6:
                    raise InputError(
                        f"line {line}: expected Point index x y z frame, got {text!r}"
                    )
                names.append(f"{cluster}.{track}")
                lines.append(line)
                cells.append(words[2:6])
        if not cells:
            raise InputError("no line begins with Point; save the tracks again")
        columns: dict[str, Sequence[str]] = dict(
            zip(_NAMES, zip(*cells, strict=True), strict=True)
        )
        table = Table(columns, np.array(lines), faults=source.faults)
        z = table.numbers("z")
        return Tracks(
            x=table.numbers("x"),
            y=table.numbers("y"),
            z=z if np.ptp(z) > 0 else None,
            place=table.row,
            particle=names,
            frame=table.whole_numbers("frame", least=0),
            length_unit="?",
            columns={"frame": "frame"},
        )
