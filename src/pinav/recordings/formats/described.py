"""Tables and XML of several programs, described by names, parsed without entities."""

import re
from collections.abc import Mapping
from typing import Any, final

import numpy as np

from pinav.errors import InputError
from pinav.recordings import units
from pinav.recordings.formats.column_map import long_table
from pinav.recordings.formats.format import AbstractFormat
from pinav.recordings.rows import Reading, Tracks
from pinav.recordings.source import Source


def parse_xml(content: bytes) -> Any:
    """The root element of a document.

    Raises:
        InputError: it is not well formed, or declares entities or a document type.
    """
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import ParseError, fromstring

    try:
        return fromstring(content, forbid_dtd=True)
    except ParseError as error:
        line, column = error.position
        raise InputError(
            f"line {line}, column {column}: not well-formed XML "
            f"({str(error).partition(':')[0]}); export the tracks again"
        ) from error
    except DefusedXmlException as error:
        raise InputError(
            "the XML declares entities or a document type, which is not read; "
            "export the tracks again"
        ) from error


def root_tag(content: bytes) -> str:
    """Name of the first element, without parsing the rest."""
    match = re.search(rb"<([A-Za-z_][\w.-]*)[\s/>]", content[:5000])
    return match[1].decode() if match else ""


def number(element: Any, name: str, where: str) -> float:
    """A number among the attributes of an element.

    Raises:
        InputError: the attribute is missing or no finite number.
    """
    text = element.get(name)
    try:
        value = float(text) if text is not None and "_" not in text else float("nan")
    except ValueError:
        value = float("nan")
    if value - value != 0:  # neither NaN nor infinite
        got = "nothing" if text is None else repr(text)
        raise InputError(
            f"{where}, attribute {name!r}: expected a finite number, got {got}; "
            "export the tracks again"
        )
    return value


@final
class DescribedTable(AbstractFormat):
    """A table that is known by its columns, one value for each program.

    Attributes:
        name: what the user calls it.
        columns: heading of each quantity, as a pattern; a star stands for the
            particles where each has columns of its own.
        length_unit: of the positions, where no column states it.
        unit_column: heading of a column that states the unit of length.
        untracked: label of rows that belong to no track.
    """

    def __init__(
        self,
        name: str,
        columns: Mapping[str, str],
        *,
        length_unit: str = "px",
        unit_column: str = "",
        untracked: str = "",
    ) -> None:
        self.name, self.columns = name, dict(columns)
        self.length_unit, self.unit_column = length_unit, unit_column
        self.untracked = untracked

    def suits(self, source: Source) -> bool:
        return set(self._headings(source.column_names)) == set(self.columns)

    def _headings(self, names: list[str]) -> dict[str, str]:
        """The heading of each quantity that the table has."""
        headings = {}
        for quantity, pattern in self.columns.items():
            if "*" in pattern:
                one = re.compile(re.escape(pattern).replace(r"\*", r"\d+"))
                if any(one.fullmatch(name) for name in names):
                    headings[quantity] = pattern
                continue
            match = [name for name in names if re.fullmatch(pattern, name)]
            if match:
                headings[quantity] = match[0]
        return headings

    def tracks(self, source: Source, reading: Reading) -> Tracks:
        table = source.table()
        headings = self._headings(list(table.columns))
        table, headings = long_table(table, headings)
        unit = self.length_unit
        if self.unit_column in table.columns:
            unit = str(table.columns[self.unit_column][0])
        if self.untracked:
            labels = table.column(headings["particle"])
            kept = [str(c or "").strip() not in ("", self.untracked) for c in labels]
            table = table.select(np.array(kept))
        factor, length_unit = units.length(unit)
        z = table.numbers(headings["z"], lost=True) if "z" in headings else None
        return Tracks(
            x=factor * table.numbers(headings["x"], lost=True),
            y=factor * table.numbers(headings["y"], lost=True),
            z=None if z is None or np.ptp(z[np.isfinite(z)]) == 0 else factor * z,
            place=table.row,
            particle=table.labels(headings["particle"])
            if "particle" in headings
            else None,
            frame=table.whole_numbers(headings["frame"], least=0)
            if "frame" in headings
            else None,
            time=table.numbers(headings["t"]) if "t" in headings else None,
            length_unit=length_unit,
            columns={"frame": headings.get("frame", ""), "time": headings.get("t", "")},
            notes=table.notes,
        )


IMARIS = DescribedTable(
    "imaris",
    {
        "x": "Position X",
        "y": "Position Y",
        "z": "Position Z",
        "frame": "Time",
        "particle": "TrackID|Parent",
    },
    length_unit="um",
    unit_column="Unit",
)
"""`Position.csv`: titles, `Position X` ... `Time` (a frame), `TrackID`, `Unit`."""

CELLPROFILER = DescribedTable(
    "cellprofiler",
    {
        "x": "(Location|AreaShape)_Center_X",
        "y": "(Location|AreaShape)_Center_Y",
        "frame": "ImageNumber",
        "particle": r"TrackObjects_Label(_\d+)?",
    },
    untracked="nan",
)
"""Objects: `ImageNumber`, `Location_Center_X`, `TrackObjects_Label_50`; px, y down."""

NAPARI = DescribedTable(
    "napari",
    {"x": "x", "y": "y", "z": "z", "frame": "t", "particle": "ID|track_id"},
)
"""Tracks of btrack or napari with z: `ID, t, x, y, z`, t a frame; px, y down."""

NAPARI_PLANE = DescribedTable(
    "napari-plane", {"x": "x", "y": "y", "frame": "t", "particle": "ID|track_id"}
)
"""The same without z."""

IDTRACKER = DescribedTable("idtracker.ai", {"t": "seconds|time", "x": "x*", "y": "y*"})
"""`trajectories.csv`: seconds and the columns x1, y1, x2, y2...; px, y down."""

TREX_TABLE = DescribedTable(
    "trex-csv",
    {
        "x": r"X#wcentroid( \(cm\))?",
        "y": r"Y#wcentroid( \(cm\))?",
        "frame": "frame",
        "t": "time",
    },
    length_unit="cm",
)
"""One individual as TRex exports it to CSV: cm, seconds, y down."""

DESCRIBED = (TREX_TABLE, IMARIS, CELLPROFILER, NAPARI, NAPARI_PLANE, IDTRACKER)
"""All of them, in the order in which a file is tried."""
