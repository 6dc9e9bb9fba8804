"""TrackMate: the project file, with all spots, tracks and settings."""

from typing import Any, final

import numpy as np

from pinav.errors import InputError
from pinav.recordings import units
from pinav.recordings.formats.described import number, parse_xml, root_tag
from pinav.recordings.formats.format import AbstractFormat
from pinav.recordings.rows import Reading, Tracks
from pinav.recordings.source import Source


@final
class TrackMateProject(AbstractFormat):
    """`<TrackMate>` with `<AllSpots>`, `<AllTracks>` and `<FilteredTracks>`; y down.

    A spot belongs to the track whose edges name it; tracks that the filters dropped,
    and spots without a track, are left out. Times are frames times the interval of the
    settings, unless that is the 1 of a film that was never calibrated.
    """

    name = "trackmate-project"

    def suits(self, source: Source) -> bool:
        return source.kind == "xml" and root_tag(source.content) == "TrackMate"

    def tracks(self, source: Source, reading: Reading) -> Tracks:
        root = parse_xml(source.content)
        model = root.find("Model")
        if model is None:
            raise InputError("element <TrackMate>: no <Model> in it; save it again")
        owner = _owners(model)
        rows = [
            (owner[spot.get("ID")], spot)
            for spot in model.iterfind("AllSpots/SpotsInFrame/Spot")
            if spot.get("ID") in owner
        ]
        if not rows:
            raise InputError(
                "element <AllTracks>: no spot belongs to a track; track them, then "
                "save the project again"
            )
        places = [f"spot {spot.get('ID')}" for _, spot in rows]
        values = np.array(
            [
                [number(spot, f"{name}", place) for name in _ATTRIBUTES]
                for (_, spot), place in zip(rows, places, strict=True)
            ]
        )
        x, y, z, frame = values.T
        factor, unit = units.length(model.get("spatialunits"))
        rate, time_unit = units.duration(model.get("timeunits"))
        interval = _interval(root)
        frames = np.round(frame).astype(np.int64)
        timed = interval is not None and time_unit != "frame"
        time = rate * interval * frames if interval is not None and timed else None
        return Tracks(
            x=factor * x,
            y=factor * y,
            z=factor * z if np.ptp(z) > 0 else None,
            place=places.__getitem__,
            particle=[name for name, _ in rows],
            frame=frames,
            time=time,
            length_unit=unit,
            time_unit=time_unit if timed else "frame",
            columns={"frame": "FRAME"},
        )


_ATTRIBUTES = ("POSITION_X", "POSITION_Y", "POSITION_Z", "FRAME")


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


def _interval(root: Any) -> float | None:
    """Time from frame to frame; None where the film was never calibrated."""
    image = root.find("Settings/ImageData")
    if image is None or image.get("timeinterval") is None:
        return None
    value = number(image, "timeinterval", "element <ImageData>")
    return None if value in (0.0, 1.0) else value
