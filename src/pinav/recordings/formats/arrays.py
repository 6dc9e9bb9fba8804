"""Arrays of NumPy: one individual of TRex, and the trajectories of idtracker.ai."""

import importlib
import io
import pickle
import zipfile
from typing import Any, final

import numpy as np

from pinav.errors import InputError
from pinav.recordings.rows import Tracks
from pinav.recordings.source import AbstractFormat, Source
from pinav.trajectories.npz_files import read_header

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

    def tracks(self, source: Source) -> Tracks:
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
        stated = "x" in (source.reading.units or {}) or source.reading.mpp
        scale = 1.0 if stated else _CENTIMETRE
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


_HEADER = 200
"""Bytes within which an array says that it holds one object."""


@final
class IdTracker(AbstractFormat):
    """`trajectories` [frame, individual, axis] in px and `frames_per_second`; y down.

    The file is one serialised object. Only numbers, words and arrays are made of it;
    whatever else stands in it is passed over, and nothing of it is executed.
    """

    name = "idtracker.ai-npy"

    def suits(self, source: Source) -> bool:
        head = source.content[:_HEADER]
        return source.kind == "array" and b"'|O'" in head and b"'shape': ()" in head

    def tracks(self, source: Source) -> Tracks:
        said = _object(source.content)
        paths = said.get("trajectories") if isinstance(said, dict) else None
        if not isinstance(paths, np.ndarray) or paths.ndim != 3 or paths.shape[2] != 2:
            raise InputError(
                "expected trajectories by frame, individual and axis; export "
                "trajectories.csv in place of it"
            )
        paths = paths.astype(np.float64)
        count, individuals, _ = paths.shape
        frame = np.tile(np.arange(count), individuals)
        rate = said.get("frames_per_second")
        rate = float(rate) if isinstance(rate, int | float) else 0.0
        known = 0 < rate < np.inf
        return Tracks(
            x=paths[:, :, 0].T.ravel(),
            y=paths[:, :, 1].T.ravel(),
            place=lambda row: f"individual {row // count + 1}, frame {row % count}",
            particle=[str(i + 1) for i in range(individuals) for _ in range(count)],
            frame=frame,
            time=frame / rate if known else None,
            time_unit="s" if known else "frame",
        )


class _Nothing:
    """Stands for an object of any other kind; it does nothing."""

    def __new__(cls, *_: Any, **__: Any) -> "_Nothing":
        return super().__new__(cls)

    def __setstate__(self, state: Any) -> None:
        """Ignored."""


_ARRAYS = {
    *(("numpy._core.multiarray", name) for name in ("_reconstruct", "scalar")),
    *(("numpy", name) for name in ("ndarray", "dtype")),
}
"""Constructors of arrays and of their numbers."""


class _Reader(pickle.Unpickler):
    """Makes plain values and arrays, and `_Nothing` of all else."""

    def find_class(self, module: str, name: str) -> Any:
        module = module.replace("numpy.core", "numpy._core")  # as before NumPy 2
        if (module, name) not in _ARRAYS:
            return _Nothing
        return getattr(importlib.import_module(module), name)


def _object(content: bytes) -> Any:
    """The object in an array of no dimension."""
    file = io.BytesIO(content)
    try:
        read_header(file)
        array = _Reader(file).load()
    except Exception as error:  # whatever a damaged object leads to
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise InputError(
            f"damaged array: {reason}; export trajectories.csv in place of it"
        ) from error
    return array.item() if isinstance(array, np.ndarray) and not array.ndim else array
