"""TrackMate: spots as CSV, raw or re-saved, and tracks as XML."""

from typing import Any, final

import numpy as np

from pinav.errors import InputError
from pinav.recordings import units
from pinav.recordings.formats.described import number, parse_xml
from pinav.recordings.formats.format import AbstractFormat
from pinav.recordings.rows import Reading, Tracks
from pinav.recordings.source import Source
from pinav.recordings.table import Table

_COLUMNS = ("TRACK_ID", "POSITION_X", "POSITION_Y", "FRAME")
_ABOVE = 3
"""Rows between the names and the numbers of a raw file: two of names, one of units."""

UNCALIBRATED = (
    "times equal the frame numbers, although they are said to be in {unit}: they are "
    "read as frames; give fps (1 if the camera did take one frame in a second)"
)


@final
class TrackMateCSV(AbstractFormat):
    """`TRACK_ID, POSITION_X, POSITION_Y, POSITION_T, FRAME`, y down.

    A raw export has four header rows, the last with the units; a re-saved file has one
    and no units. Spots without a track are left out. Times that only repeat the frame
    numbers are no times, whatever their unit says.
    """

    name = "trackmate-csv"

    def suits(self, source: Source) -> bool:
        return {"TRACK_ID", "POSITION_X", "FRAME"} <= set(source.column_names)

    def tracks(self, source: Source, reading: Reading) -> Tracks:
        table = source.read_text_table()
        stated: dict[str, str] = {}
        if "POSITION_X" in table.columns and _is_raw(table):
            stated = _units(table)
            table = source.read_text_table(below=_ABOVE)
        for name in _COLUMNS:
            table.column(name)
        tracked = np.array(
            [str(c or "").strip() not in ("", "None") for c in table.column("TRACK_ID")]
        )
        if not tracked.any():
            raise InputError(
                f"{table.where(0, 'TRACK_ID')}: no spot belongs to a track; track "
                "them first, then export again"
            )
        spots = table.select(tracked)
        factor, unit = units.length(stated.get("POSITION_X"))
        frame = spots.whole_numbers("FRAME", least=0)
        time, time_unit, notes = _times(spots, frame, stated, reading)
        if not tracked.all():
            notes = (*notes, f"{int((~tracked).sum())} spots without a track left out")
        if not stated:
            notes = (*notes, "no row of units: positions are px if mpp is given")
        return Tracks(
            x=factor * spots.numbers("POSITION_X", lost=True),
            y=factor * spots.numbers("POSITION_Y", lost=True),
            place=spots.row,
            particle=spots.labels("TRACK_ID"),
            frame=frame,
            time=time,
            length_unit=unit,
            time_unit=time_unit,
            columns={"frame": "FRAME", "time": "POSITION_T"},
            notes=notes,
            facts={"header rows": 1 + _ABOVE if stated else 1},
        )


def _is_raw(table: Table) -> bool:
    """Whether rows of names and units stand above the numbers."""
    return str(table.columns["POSITION_X"][0]).strip() in ("X", "Position X")


def _units(table: Table) -> dict[str, str]:
    """The row of units, which begins with a bracket wherever it says something."""
    row = _ABOVE - 1
    cells = {name: str(c[row]) for name, c in table.columns.items() if len(c) > row}
    wrong = [c for c in cells.values() if c.strip() and c.strip()[0] not in "(["]
    if not cells or wrong:
        raise InputError(
            f"line {_ABOVE + 1}: expected the row of units, such as (pixel) and (sec), "
            f"got {wrong[0] if wrong else 'nothing'!r}; a raw file has four header "
            "rows: export it again, or keep the first row alone"
        )
    return cells


def _times(
    spots: Table, frame: np.ndarray, stated: dict[str, str], reading: Reading
) -> tuple[np.ndarray | None, str, tuple[str, ...]]:
    """Times, their unit, and what is wrong with them; no times where only frames."""
    if "POSITION_T" not in spots.columns:
        return None, "frame", ()
    factor, unit = units.duration(stated.get("POSITION_T"))
    times = spots.numbers("POSITION_T")
    if np.array_equal(times, frame):
        word = units.bare(stated.get("POSITION_T")) or "a unit of time"
        return None, "frame", _calibration_remarks(word, reading)
    return factor * times, unit, ()


def _calibration_remarks(unit: str, reading: Reading) -> tuple[str, ...]:
    """That times are frames, unless the user says how many there are in a second."""
    return () if reading.fps is not None else (UNCALIBRATED.format(unit=unit),)


@final
class TrackMateXML(AbstractFormat):
    """`<Tracks>` of `<particle>` of `<detection t x y z/>` ("Export tracks to XML")."""

    name = "trackmate-xml"

    def suits(self, source: Source) -> bool:
        return source.kind == "xml"

    def tracks(self, source: Source, reading: Reading) -> Tracks:
        root = _root(source.content)
        particles = root.findall("particle")
        if not particles:
            raise InputError("element <Tracks>: no <particle> in it; export again")
        rows: list[tuple[str, str]] = []
        numbers: list[list[float]] = []
        for index, particle in enumerate(particles, start=1):
            spots = particle.findall("detection")
            _check_count(particle, index, len(spots))
            for count, spot in enumerate(spots, start=1):
                where = f"particle {index}, detection {count}"
                rows.append((str(index - 1), where))
                numbers.append([number(spot, name, where) for name in "txy"])
        if not numbers:
            raise InputError("element <particle>: no <detection>; export again")
        table = np.array(numbers, np.float64)
        factor, unit = units.length(root.get("spaceUnits"))
        frame = _frames(table[:, 0], [where for _, where in rows])
        time, time_unit, notes = _calibrated_times(root, frame, reading)
        return Tracks(
            x=factor * table[:, 1],
            y=factor * table[:, 2],
            place=lambda row: rows[row][1],
            particle=[particle for particle, _ in rows],
            frame=frame,
            time=time,
            length_unit=unit,
            time_unit=time_unit,
            columns={"frame": "t"},
            notes=notes,
        )


def _root(content: bytes) -> Any:
    """The element <Tracks>."""
    root = parse_xml(content)
    if root.tag != "Tracks":
        raise InputError(
            f"element <{root.tag}>: expected <Tracks>; in TrackMate choose 'Export "
            "tracks to XML file', or export the spots as CSV"
        )
    return root


def _check_count(particle: Any, index: int, count: int) -> None:
    stated = particle.get("nSpots")
    if stated is not None and stated.strip() != str(count):
        raise InputError(
            f"particle {index}, attribute 'nSpots': expected {stated} detections, got "
            f"{count}; export the tracks again"
        )


def _frames(values: np.ndarray, places: list[str]) -> np.ndarray:
    wrong = (values != np.round(values)) | (values < 0)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"{places[row]}, attribute 't': expected a frame, a whole number >= 0, got "
            f"{values[row]:g}; export the tracks again"
        )
    return values.astype(np.int64)


def _calibrated_times(
    root: Any, frame: np.ndarray, reading: Reading
) -> tuple[np.ndarray | None, str, tuple[str, ...]]:
    """Times from the frame interval, unless it is the 1 of a film never calibrated."""
    text = root.get("frameInterval") or "1"
    try:
        interval = float(text)
    except ValueError:
        interval = np.nan
    if not 0 < interval < np.inf:
        raise InputError(
            f"element <Tracks>, attribute 'frameInterval': expected > 0, got {text!r}; "
            "correct it, or export again"
        )
    factor, unit = units.duration(root.get("timeUnits"))
    if unit == "frame":
        return None, unit, ()
    if interval == 1.0:
        unit = root.get("timeUnits") or "a unit of time"
        return None, "frame", _calibration_remarks(unit, reading)
    return factor * interval * frame, unit, ()
