"""MATLAB files: `[x y frame id]`, or cells of `[t x y]` as msdanalyzer keeps them."""

import io
from typing import Any, final

import numpy as np

from pinav.errors import InputError
from pinav.recordings.formats.format import AbstractFormat
from pinav.recordings.formats.zarr_arrays import open_group
from pinav.recordings.rows import Reading, Tracks
from pinav.recordings.source import Source
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

    def tracks(self, source: Source, reading: Reading) -> Tracks:
        variables = _variables(source)
        name, value = _choose_variable(
            variables, (reading.columns or {}).get("variable")
        )
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
    """The variable that holds the tracks."""
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
    return Tracks(
        x=table.numbers("x", lost=True),
        y=table.numbers("y", lost=True),
        place=table.row,
        particle=[str(i) for i in table.whole_numbers("id")],
        frame=table.whole_numbers("frame", least=0),
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
    places = [table.row(row) for table in tables for row in range(len(table))]
    return Tracks(
        x=np.concatenate([table.numbers("x", lost=True) for table in tables]),
        y=np.concatenate([table.numbers("y", lost=True) for table in tables]),
        place=places.__getitem__,
        particle=[str(i) for i, t in enumerate(tables, start=1) for _ in range(len(t))],
        time=np.concatenate([table.numbers("t") for table in tables]),
        length_unit="?",
        time_unit="?",
        columns={"time": "t"},
        facts={"variable": name},
    )
