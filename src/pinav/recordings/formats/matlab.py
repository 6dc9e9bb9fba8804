"""MATLAB files: `[x y frame id]`, cells of `[t x y]`, and the tracks of u-track."""

import io
from typing import Any, final

import numpy as np

from pinav.errors import InputError
from pinav.recordings.formats.zarr_arrays import open_group
from pinav.recordings.rows import Tracks, varying
from pinav.recordings.source import AbstractFormat, Source
from pinav.recordings.table import Table

_FIRST = ("tr", "tracks", "trajectories", "res", "result")
"""Variables that are taken where several would do."""

_NAMES = ("x", "y", "frame", "id")


@final
class Matlab(AbstractFormat):
    """One matrix with x and y first and frame and id last, or a cell array of tracks.

    The matrix is that of Crocker and Grier's `track`: px and y down unless stated
    otherwise. Tracks `[t x y]` are in units that the file does not state. Files of
    MATLAB 7.3 (HDF5) hold the matrix only. `columns={"variable": "tr"}` chooses one.
    """

    name = "matlab"

    def suits(self, source: Source) -> bool:
        return source.content.startswith(b"MATLAB")

    def tracks(self, source: Source) -> Tracks:
        variables = _variables(source)
        stated = (source.reading.columns or {}).get("variable")
        name, value = _choose_variable(variables, stated)
        if value.dtype == object:
            return _of_cells(name, value)
        return _of_matrix(name, value)


def _variables(source: Source) -> dict[str, np.ndarray]:
    """The numeric matrices and the cell arrays of a file, by name."""
    if source.kind == "hdf5":
        with open_group(source.content) as file:
            # MATLAB stores columns first.
            return {
                name: np.asarray(item).T
                for name, item in file.items()
                if hasattr(item, "dtype") and item.dtype.kind in "fiu"
            }
    from scipy.io import loadmat

    try:
        variables = loadmat(io.BytesIO(source.content))
    except Exception as error:  # zlib's, scipy's and Python's own share no base
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise InputError(
            f"damaged MATLAB file: {reason}; save it again (save -v7 tracks.mat tr)"
        ) from error
    return {
        name: value
        for name, value in variables.items()
        if not name.startswith("__") and isinstance(value, np.ndarray)
    }


def _choose_variable(
    variables: dict[str, np.ndarray], name: str | None
) -> tuple[str, np.ndarray]:
    fitting = {n: v for n, v in variables.items() if _fits(v)}
    if name is not None:
        if name not in variables:
            raise InputError(
                f"columns: no variable {name!r}; got {', '.join(variables) or 'none'}"
            )
        if name not in fitting:
            shape = variables[name].shape
            raise InputError(
                f"variable {name!r}: expected a matrix [x y frame id] or a cell array "
                f"of [t x y], got shape {shape}"
            )
        return name, variables[name]
    preferred = [n for n in _FIRST if n in fitting] or list(fitting)
    if not preferred or (len(fitting) > 1 and preferred[0] not in _FIRST):
        shapes = ", ".join(f"{n} {v.shape}" for n, v in variables.items())
        raise InputError(
            "expected one matrix [x y frame id] or one cell array of [t x y], got "
            f"{shapes or 'no variables'}; name it by columns={{'variable': 'tr'}}"
        )
    return preferred[0], variables[preferred[0]]


def _fits(value: Any) -> bool:
    if value.dtype == object:
        return value.size > 0 and all(_is_track(cell) for cell in value.flat)
    return value.ndim == 2 and value.shape[1] >= 4 and value.dtype.kind in "fiu"


def _is_track(cell: Any) -> bool:
    return (
        isinstance(cell, np.ndarray)
        and cell.ndim == 2
        and cell.shape[1] == 3
        and cell.dtype.kind in "fiu"
    )


def _of_matrix(name: str, matrix: np.ndarray) -> Tracks:
    """Columns x and y first, frame and id last; what is between is left out."""
    if not len(matrix):
        raise InputError(f"variable {name!r}: no rows; expected [x y frame id]")
    columns = (matrix[:, 0], matrix[:, 1], matrix[:, -2], matrix[:, -1])
    table = Table(
        dict(zip(_NAMES, columns, strict=True)),
        np.arange(1, len(matrix) + 1),
        f"variable {name!r}, row",
    )
    return Tracks.of_table(
        table,
        {"x": "x", "y": "y", "frame": "frame"},
        particle=[str(i) for i in table.whole_numbers("id")],
        facts={"variable": name},
    )


def _of_cells(name: str, cells: np.ndarray) -> Tracks:
    tables = [
        Table(
            {"t": cell[:, 0], "x": cell[:, 1], "y": cell[:, 2]},
            np.arange(1, len(cell) + 1),
            f"variable {name!r}, cell {index}, row",
        )
        for index, cell in enumerate(cells.flat, start=1)
        if len(cell)
    ]
    if not tables:
        raise InputError(f"variable {name!r}: all cells are empty; expected [t x y]")
    return Tracks.of_table(
        Table.concatenate(tables),
        {"x": "x", "y": "y", "t": "t"},
        particle=[str(i) for i, t in enumerate(tables, start=1) for _ in range(len(t))],
        length_unit="?",
        time_unit="?",
        facts={"variable": name},
    )


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
        return source.kind == "matlab" and _compound(source) is not None

    def tracks(self, source: Source) -> Tracks:
        value = _compound(source)
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
            z=varying(z),
            place=lambda row: f"track {names[row]}, frame {frame[row]}",
            particle=names,
            frame=frame,
        )


def _compound(source: Source) -> Any:
    """The structures of the tracks, or None; loading is quick and runs nothing."""
    from scipy.io import loadmat

    try:
        content = loadmat(io.BytesIO(source.content), variable_names=["tracksFinal"])
    except Exception:  # zlib's, scipy's and Python's own share no base
        return None
    value = content.get("tracksFinal")
    names = getattr(getattr(value, "dtype", None), "names", None) or ()
    return value if set(_FIELDS) <= set(names) else None
