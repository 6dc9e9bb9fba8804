"""idtracker.ai's `trajectories.npy`: a dictionary in an array of objects."""

import importlib
import io
import pickle
from typing import Any, final

import numpy as np

from pinav.errors import InputError
from pinav.recordings.formats.format import AbstractFormat
from pinav.recordings.rows import Reading, Tracks
from pinav.recordings.source import Source

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

    def tracks(self, source: Source, reading: Reading) -> Tracks:
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
        """Nothing is kept."""


_ARRAYS = {
    *(("numpy._core.multiarray", name) for name in ("_reconstruct", "scalar")),
    *(("numpy", name) for name in ("ndarray", "dtype")),
}
"""What arrays and their numbers are made of."""


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
        version = np.lib.format.read_magic(file)
        read = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }[version]
        read(file)
        array = _Reader(file).load()
    except Exception as error:  # whatever a damaged object leads to
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise InputError(
            f"damaged array: {reason}; export trajectories.csv in place of it"
        ) from error
    return array.item() if isinstance(array, np.ndarray) and not array.ndim else array
