"""A tracker's growing table of text, as lines of the protocol.

The columns are those of a tidy table (docs/recordings.md): `t_s` or `t`, `x_um` and
`y_um` or `x` and `y`, y upwards; `frame`, `freq_hz` and `alpha_rad` where there are
any.
"""

import dataclasses
import math
from collections.abc import Mapping

from pinav.live.messages import VERSION, Frame, Hello, Limits, encode

NAMES: Mapping[str, tuple[str, ...]] = {
    "t": ("t_s", "t", "time"),
    "x": ("x_um", "x"),
    "y": ("y_um", "y"),
    "seq": ("frame", "seq"),
    "frequency": ("freq_hz", "frequency"),
    "heading": ("alpha_rad", "heading"),
}
"""Columns of each quantity, the first one that a table has counts."""


@dataclasses.dataclass(frozen=True)
class TableReader:
    """Rows of a table become frames; the first two say what the step is.

    A row that cannot be read is passed on as it is, for the session to refuse it.

    Attributes:
        session: name of the session.
        limits: what may be commanded, which a table does not say.
        places: column of each quantity; none before the header.
        first: the first row, which waits for the second.
        rows: number of rows so far, which counts where the table has no frames.
        greeted: the hello has been made.
    """

    session: str
    limits: Limits
    places: Mapping[str, int] | None = None
    first: bytes | None = None
    rows: int = 0
    greeted: bool = False

    def after(self, line: bytes) -> tuple["TableReader", list[bytes]]:
        """The reader and the lines of the protocol after a line of the table."""
        places = header_places(line)
        if places is not None:
            return dataclasses.replace(self, places=places, first=None), []
        if self.places is None:
            return self, [line]
        frame = self._frame(line)
        reader = dataclasses.replace(self, rows=self.rows + 1)
        if frame is None:
            return reader, [line]
        if self.greeted:
            return reader, [encode(frame).rstrip()]
        earlier = None if self.first is None else self._frame(self.first, self.rows - 1)
        if earlier is None or self.first is None or frame.t <= earlier.t:
            return dataclasses.replace(reader, first=line), []
        hello = Hello(
            version=VERSION,
            session=self.session,
            step=frame.t - earlier.t,
            limits=self.limits,
        )
        lines = [encode(message).rstrip() for message in (hello, earlier, frame)]
        return dataclasses.replace(reader, greeted=True, first=None), lines

    def _frame(self, line: bytes, row: int | None = None) -> Frame | None:
        """The frame in a row; none where it is damaged."""
        assert self.places is not None
        cells = line.split(b",")
        values: dict[str, float] = {}
        for name, place in self.places.items():
            if place >= len(cells):
                return None
            try:
                values[name] = float(cells[place] or b"nan")
            except ValueError:
                return None
        here = {n: v if math.isfinite(v) else None for n, v in values.items()}
        time, number = here["t"], here.get("seq", self.rows if row is None else row)
        if time is None or number is None or number < 0:
            return None
        return Frame(
            seq=int(number),
            t=time,
            x=here["x"],
            y=here["y"],
            frequency=max(here.get("frequency") or 0.0, 0.0),
            heading=here.get("heading") or 0.0,
        )


def header_places(line: bytes) -> dict[str, int] | None:
    """The column of each quantity in a header; none in a line that is no header."""
    titles = [cell.strip().lower() for cell in line.decode(errors="replace").split(",")]
    places = {
        name: titles.index(next(title for title in names if title in titles))
        for name, names in NAMES.items()
        if set(names) & set(titles)
    }
    return places if {"t", "x", "y"} <= set(places) else None
