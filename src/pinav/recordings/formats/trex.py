"""TRex: one individual, an archive of NumPy arrays."""

import io
import zipfile
from typing import final

import numpy as np

from pinav.errors import InputError
from pinav.recordings.formats.format import AbstractFormat
from pinav.recordings.rows import Reading, Tracks
from pinav.recordings.source import Source

_POSITIONS = (
    ("X#wcentroid", "Y#wcentroid"),
    ("X", "Y"),
    ("X#pcentroid", "Y#pcentroid"),
)
_CENTIMETRE = 1e4


@final
class TRex(AbstractFormat):
    """`X#wcentroid, Y#wcentroid` (or `X, Y`) in cm, `frame`, `time`, `missing`; y down.

    Rows that are missing hold infinity and count as lost. Where TRex was not told the
    length of a pixel, its centimetres are pixels: state `units={"x": "px"}` then.
    """

    name = "trex"

    def suits(self, source: Source) -> bool:
        if source.kind != "zip":
            return False
        try:
            with zipfile.ZipFile(io.BytesIO(source.content)) as archive:
                names = set(archive.namelist())
        except (zipfile.BadZipFile, OSError):
            return False
        return any({f"{x}.npy", f"{y}.npy"} <= names for x, y in _POSITIONS)

    def tracks(self, source: Source, reading: Reading) -> Tracks:
        try:
            with np.load(io.BytesIO(source.content), allow_pickle=False) as archive:
                arrays = {n: archive[n] for n in archive.files if n in _WANTED}
        except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
            raise InputError(
                f"damaged archive: {str(error).partition('. ')[0]}; export it again"
            ) from error
        pair = next(pair for pair in _POSITIONS if set(pair) <= set(arrays))
        clock = next((n for n in ("time", "frame") if n in arrays), None)
        if clock is None:
            raise InputError(
                f"arrays {', '.join(arrays)}: expected time or frame; add them to "
                "output_fields and export again"
            )
        lengths = {name: len(np.ravel(values)) for name, values in arrays.items()}
        if len({lengths[n] for n in (*pair, clock)}) > 1:
            raise InputError(f"arrays of {lengths} values: expected equal lengths")
        x, y = (np.ravel(arrays[name]).astype(np.float64) for name in pair)
        lost = ~(np.isfinite(x) & np.isfinite(y))
        if "missing" in arrays:
            lost |= np.ravel(arrays["missing"]) > 0
        # What the user states of the unit replaces the centimetre.
        scale = 1.0 if "x" in (reading.units or {}) or reading.mpp else _CENTIMETRE
        return Tracks(
            x=np.where(lost, np.nan, scale * x),
            y=np.where(lost, np.nan, scale * y),
            place=lambda row: f"row {row}",
            frame=np.ravel(arrays["frame"]).astype(np.int64)
            if "frame" in arrays
            else None,
            time=np.ravel(arrays["time"]).astype(np.float64)
            if "time" in arrays
            else None,
            length_unit="um" if scale == _CENTIMETRE else "px",
            notes=("positions are cm, if TRex knew the length of a pixel",),
        )


_WANTED = {"time", "frame", "missing", *(name for pair in _POSITIONS for name in pair)}
