"""u-track: compound tracks in a MATLAB file."""

import io
from typing import Any, final

import numpy as np

from pinav.errors import InputError
from pinav.recordings.formats.format import AbstractFormat
from pinav.recordings.rows import Reading, Tracks
from pinav.recordings.source import Source

_FIELDS = ("tracksCoordAmpCG", "seqOfEvents")
_PER_FRAME = 8
"""Numbers of a particle in a frame: x, y, z, amplitude, and their deviations."""


@final
class UTrack(AbstractFormat):
    """`tracksFinal` with `tracksCoordAmpCG` and `seqOfEvents`; px, y down.

    Each row of a compound track, a segment between merges and splits, is a particle.
    Files of MATLAB 7.3 are not read: save them with -v7.
    """

    name = "u-track"

    def suits(self, source: Source) -> bool:
        return source.kind == "matlab" and _variable(source) is not None

    def tracks(self, source: Source, reading: Reading) -> Tracks:
        value = _variable(source)
        if value is None:
            raise InputError("no variable tracksFinal with tracksCoordAmpCG; save it")
        frames, names, rows = [], [], []
        for number, track in enumerate(np.ravel(value), start=1):
            numbers = np.atleast_2d(np.asarray(track[_FIELDS[0]], np.float64))
            events = np.atleast_2d(np.asarray(track[_FIELDS[1]], np.float64))
            if numbers.shape[1] % _PER_FRAME or not events.size:
                raise InputError(
                    f"track {number}: expected {_PER_FRAME} columns for each frame, "
                    f"got {numbers.shape[1]}; save tracksFinal again"
                )
            first = int(events[:, 0].min())
            for part, row in enumerate(numbers, start=1):
                table = row.reshape(-1, _PER_FRAME)
                observed = np.flatnonzero(np.isfinite(table[:, 0]))
                frames.append(first + observed)
                rows.append(table[observed, :3])
                label = f"{number}" if len(numbers) == 1 else f"{number}.{part}"
                names += [label] * len(observed)
        x, y, z = np.concatenate(rows).T
        frame = np.concatenate(frames).astype(np.int64)
        return Tracks(
            x=x,
            y=y,
            z=z if len(z) and np.ptp(z) > 0 else None,
            place=lambda row: f"track {names[row]}, frame {frame[row]}",
            particle=names,
            frame=frame,
        )


def _variable(source: Source) -> Any:
    """The structures of the tracks, or None; loading is quick and runs nothing."""
    from scipy.io import loadmat

    try:
        content = loadmat(io.BytesIO(source.content), variable_names=["tracksFinal"])
    except Exception:  # zlib's, scipy's and Python's own share no base
        return None
    value = content.get("tracksFinal")
    names = getattr(getattr(value, "dtype", None), "names", None) or ()
    return value if set(_FIELDS) <= set(names) else None
