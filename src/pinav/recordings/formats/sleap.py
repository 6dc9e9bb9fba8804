"""SLEAP: the analysis file, HDF5."""

from typing import Any, final

import numpy as np

from pinav.errors import InputError
from pinav.recordings.formats.format import AbstractFormat
from pinav.recordings.formats.zarr_arrays import open_group
from pinav.recordings.rows import Reading, Tracks
from pinav.recordings.source import Source


@final
class Sleap(AbstractFormat):
    """`tracks` (track, axis, node, frame), `node_names`, `point_scores`; px, y down.

    Each node of each track is a particle, named by both where there are several nodes.
    Points with a score below the likelihood of the reading are lost.
    """

    name = "sleap"

    def suits(self, source: Source) -> bool:
        return source.kind == "hdf5" and b"node_names" in source.content

    def tracks(self, source: Source, reading: Reading) -> Tracks:
        with open_group(source.content) as file:
            if "tracks" not in file or "node_names" not in file:
                raise InputError(
                    f"groups {', '.join(file)}: expected tracks and node_names; export "
                    "an analysis file (sleap-convert --format analysis)"
                )
            points = np.asarray(file["tracks"], np.float64)
            nodes = [_word(name) for name in file["node_names"]]
            names = [_word(name) for name in file.get("track_names", ())]
            scores = file.get("point_scores")
            scores = None if scores is None else np.asarray(scores, np.float64)
        if points.ndim != 4 or points.shape[1:3] != (2, len(nodes)):
            raise InputError(
                f"tracks: expected the shape (track, 2, {len(nodes)} nodes, frame), "
                f"got {points.shape}; export the analysis file again"
            )
        count, _, parts, frames = points.shape
        names = names if len(names) == count else [str(i) for i in range(count)]
        labels = [n if parts == 1 else f"{n} {part}" for n in names for part in nodes]
        # One row of positions for each track and node.
        x, y = (points[:, axis].reshape(count * parts, frames) for axis in (0, 1))
        lost = np.isnan(x) | np.isnan(y)
        if scores is not None and scores.shape == (count, parts, frames):
            lost |= ~(scores.reshape(x.shape) >= reading.likelihood)
        places = [f"{label!r}, frame" for label in labels]
        return Tracks(
            x=np.where(lost, np.nan, x).ravel(),
            y=np.where(lost, np.nan, y).ravel(),
            place=lambda row: f"{places[row // frames]} {row % frames}",
            particle=[label for label in labels for _ in range(frames)],
            frame=np.tile(np.arange(frames), count * parts),
            facts={"likelihood": reading.likelihood},
        )


def _word(value: Any) -> str:
    return value.decode() if isinstance(value, bytes) else str(value)
