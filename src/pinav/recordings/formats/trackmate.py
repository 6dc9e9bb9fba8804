"""TrackMate and Icy: spots as CSV, raw or re-saved; tracks and projects as XML."""

import re
from collections.abc import Iterable, Sequence
from typing import Any, final

import numpy as np

from pinav.errors import InputError
from pinav.recordings import units
from pinav.recordings.formats.tables import tracked
from pinav.recordings.rows import Reading, Tracks, varying
from pinav.recordings.source import AbstractFormat, Source
from pinav.recordings.table import Table

_HEADINGS = {
    "particle": "TRACK_ID",
    "x": "POSITION_X",
    "y": "POSITION_Y",
    "frame": "FRAME",
    "t": "POSITION_T",
}
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

    def tracks(self, source: Source) -> Tracks:
        table = source.read_text_table()
        stated: dict[str, str] = {}
        first = [str(cell).strip() for cell in table.columns.get("POSITION_X", ())[:1]]
        if first in (["X"], ["Position X"]):
            stated = _units(table)
            table = source.read_text_table(below=_ABOVE)
        for name in ("particle", "x", "y", "frame"):
            table.column(_HEADINGS[name])
        spots = tracked(table, "TRACK_ID", "None")
        if not len(spots):
            raise InputError(
                f"{table.where(0, 'TRACK_ID')}: no spot belongs to a track; track "
                "them first, then export again"
            )
        factor, unit = units.length(stated.get("POSITION_X"))
        frame = spots.whole_numbers("FRAME", least=0)
        time, time_unit, notes = _times(spots, frame, stated, source.reading)
        if left_out := len(table) - len(spots):
            notes = (*notes, f"{left_out} spots without a track left out")
        if not stated:
            notes = (*notes, "no row of units: positions are px if mpp is given")
        return Tracks.of_table(
            spots,
            _HEADINGS,
            scale=factor,
            frame=frame,
            time=time,
            length_unit=unit,
            time_unit=time_unit,
            notes=notes,
            facts={"header rows": 1 + _ABOVE if stated else 1},
        )


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
    """Remark that times are frames, unless the user states a frame rate."""
    return () if reading.fps is not None else (UNCALIBRATED.format(unit=unit),)


def _parse(content: bytes) -> Any:
    """The root element of a document, parsed without entities."""
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


def _root_tag(content: bytes) -> str:
    """Name of the first element, without parsing the rest."""
    match = re.search(rb"<([A-Za-z_][\w.-]*)[\s/>]", content[:5000])
    return match[1].decode() if match else ""


Spot = tuple[str, str, Any]
"""Name of the particle of a position, its place for messages, and its element."""


def _detections(parents: Iterable[Spot]) -> list[Spot]:
    """The detections within elements, one element after the other."""
    return [
        (name, f"{place}, detection {count}", one)
        for name, place, parent in parents
        for count, one in enumerate(parent.iterfind("detection"), start=1)
    ]


def _table(spots: Sequence[Spot], names: Iterable[str], source: Source) -> Table:
    """The attributes of spots as columns of text."""
    particles, places, elements = zip(*spots, strict=True)
    columns = {name: [one.get(name) for one in elements] for name in names}
    rows = np.array(places, object)
    return Table({"particle": particles, **columns}, rows, "", faults=source.faults)


def _tracks(
    table: Table, axes: Sequence[str], frame: str, scale: float = 1.0, **others: Any
) -> Tracks:
    """The rows of a table in which every spot has a place; z is kept if it varies."""
    x, y, *heights = (scale * table.numbers(name) for name in axes)
    headings = {"x": axes[0], "y": axes[1], "particle": "particle", "frame": frame}
    z = varying(heights[0]) if heights else None
    return Tracks.of_table(table, headings, x=x, y=y, z=z, **others)


@final
class TrackMateXML(AbstractFormat):
    """`<Tracks>` of `<particle>` of `<detection t x y z/>` ("Export tracks to XML")."""

    name = "trackmate-xml"

    def suits(self, source: Source) -> bool:
        return source.kind == "xml"

    def tracks(self, source: Source) -> Tracks:
        root = _root(source.content)
        particles = root.findall("particle")
        if not particles:
            raise InputError("element <Tracks>: no <particle> in it; export again")
        for index, particle in enumerate(particles, start=1):
            _check_count(particle, index)
        spots = _detections(
            (str(i), f"particle {i + 1}", one) for i, one in enumerate(particles)
        )
        if not spots:
            raise InputError("element <particle>: no <detection>; export again")
        factor, unit = units.length(root.get("spaceUnits"))
        table = _table(spots, "txy", source)
        frame = table.whole_numbers("t", least=0)
        time, time_unit, notes = _calibrated_times(root, frame, source.reading)
        return _tracks(
            table,
            "xy",
            "t",
            factor,
            time=time,
            length_unit=unit,
            time_unit=time_unit,
            notes=notes,
        )


def _root(content: bytes) -> Any:
    root = _parse(content)
    if root.tag != "Tracks":
        raise InputError(
            f"element <{root.tag}>: expected <Tracks>; in TrackMate choose 'Export "
            "tracks to XML file', or export the spots as CSV"
        )
    return root


def _check_count(particle: Any, index: int) -> None:
    stated, count = particle.get("nSpots"), len(particle.findall("detection"))
    if stated is not None and stated.strip() != str(count):
        raise InputError(
            f"particle {index}, attribute 'nSpots': expected {stated} detections, got "
            f"{count}; export the tracks again"
        )


def _calibrated_times(
    root: Any, frame: np.ndarray, reading: Reading
) -> tuple[np.ndarray | None, str, tuple[str, ...]]:
    """Times from the frame interval, unless it is the 1 of a film never calibrated."""
    where = "element <Tracks>, attribute 'frameInterval'"
    interval = units.interval(where, root.get("frameInterval") or "1")
    factor, unit = units.duration(root.get("timeUnits"))
    if unit == "frame":
        return None, unit, ()
    if interval == 1.0:
        unit = root.get("timeUnits") or "a unit of time"
        return None, "frame", _calibration_remarks(unit, reading)
    return factor * interval * frame, unit, ()


@final
class TrackMateProject(AbstractFormat):
    """`<TrackMate>` with `<AllSpots>`, `<AllTracks>` and `<FilteredTracks>`; y down.

    A spot belongs to the track whose edges name it; tracks that the filters dropped,
    and spots without a track, are left out. Times are frames times the interval of the
    settings, unless that is the 1 of a film that was never calibrated.
    """

    name = "trackmate-project"

    def suits(self, source: Source) -> bool:
        return source.kind == "xml" and _root_tag(source.content) == "TrackMate"

    def tracks(self, source: Source) -> Tracks:
        root = _parse(source.content)
        model = root.find("Model")
        if model is None:
            raise InputError("element <TrackMate>: no <Model> in it; save it again")
        owner = _owners(model)
        spots = [
            (owner[spot.get("ID")], f"spot {spot.get('ID')}", spot)
            for spot in model.iterfind("AllSpots/SpotsInFrame/Spot")
            if spot.get("ID") in owner
        ]
        if not spots:
            raise InputError(
                "element <AllTracks>: no spot belongs to a track; track them, then "
                "save the project again"
            )
        axes = [f"POSITION_{axis}" for axis in "XYZ"]
        table = _table(spots, [*axes, "FRAME"], source)
        factor, unit = units.length(model.get("spatialunits"))
        rate, time_unit = units.duration(model.get("timeunits"))
        interval = None if time_unit == "frame" else _interval(root, source)
        frame = table.whole_numbers("FRAME", least=0)
        return _tracks(
            table,
            axes,
            "FRAME",
            factor,
            time=None if interval is None else rate * interval * frame,
            length_unit=unit,
            time_unit="frame" if interval is None else time_unit,
        )


def _owners(model: Any) -> dict[str, str]:
    """Track of each spot, by their numbers; of the tracks that the filters kept."""
    kept = {t.get("TRACK_ID") for t in model.iterfind("FilteredTracks/TrackID")}
    owners = {}
    for track in model.iterfind("AllTracks/Track"):
        name = track.get("TRACK_ID")
        if kept and name not in kept:
            continue
        for edge in track.iterfind("Edge"):
            for end in ("SPOT_SOURCE_ID", "SPOT_TARGET_ID"):
                owners[edge.get(end)] = name
    return owners


def _interval(root: Any, source: Source) -> float | None:
    """Time from frame to frame; None where the film was never calibrated."""
    image = root.find("Settings/ImageData")
    if image is None or image.get("timeinterval") is None:
        return None
    table = _table([("", "element <ImageData>", image)], ["timeinterval"], source)
    value = float(table.numbers("timeinterval")[0])
    return None if value in (0.0, 1.0) else value


@final
class Icy(AbstractFormat):
    """`<root><trackgroup><track id><detection t x y z/>`, in pixels, y down.

    Frames are the `t` of the detections; z is kept where it varies.
    """

    name = "icy"

    def suits(self, source: Source) -> bool:
        is_root = source.kind == "xml" and _root_tag(source.content) == "root"
        return is_root and b"<trackgroup" in source.content

    def tracks(self, source: Source) -> Tracks:
        tracks = _parse(source.content).findall("trackgroup/track")
        names = [one.get("id") or str(place) for place, one in enumerate(tracks)]
        spots = _detections(
            (name, f"track {name}", one)
            for name, one in zip(names, tracks, strict=True)
        )
        if not spots:
            raise InputError(
                "element <trackgroup>: no <detection>; save the tracks again"
            )
        return _tracks(_table(spots, "txyz", source), "xyz", "t")
