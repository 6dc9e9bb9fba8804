"""Icy: tracks that its track manager saves."""

from typing import final

import numpy as np

from pinav.errors import InputError
from pinav.recordings.formats.described import number, parse_xml, root_tag
from pinav.recordings.formats.format import AbstractFormat
from pinav.recordings.rows import Reading, Tracks
from pinav.recordings.source import Source


@final
class Icy(AbstractFormat):
    """`<root><trackgroup><track id><detection t x y z/>`, in pixels, y down.

    Frames are the `t` of the detections; z is kept where it varies.
    """

    name = "icy"

    def suits(self, source: Source) -> bool:
        is_root = source.kind == "xml" and root_tag(source.content) == "root"
        return is_root and b"<trackgroup" in source.content

    def tracks(self, source: Source, reading: Reading) -> Tracks:
        root = parse_xml(source.content)
        names, places, values = [], [], []
        for group in root.iterfind("trackgroup"):
            for track in group.iterfind("track"):
                for count, spot in enumerate(track.iterfind("detection"), start=1):
                    name = track.get("id") or str(len(set(names)))
                    place = f"track {name}, detection {count}"
                    names.append(name)
                    places.append(place)
                    values.append([number(spot, key, place) for key in "txyz"])
        if not values:
            raise InputError(
                "element <trackgroup>: no <detection>; save the tracks again"
            )
        frame, x, y, z = np.array(values).T
        return Tracks(
            x=x,
            y=y,
            z=z if np.ptp(z) > 0 else None,
            place=places.__getitem__,
            particle=names,
            frame=np.round(frame).astype(np.int64),
            columns={"frame": "t"},
        )
