"""Samples of one trajectory, the checks that let them in, and tables that hold them."""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float64

from pinav.errors import InputError

Ragged = np.ndarray | Array | Sequence
"""Numbers of one trajectory, or a sequence with those of each trajectory."""


class Trajectory(eqx.Module):
    """One trajectory without padding; unobserved states are 0."""

    times: Float64[np.ndarray, " time"]
    states: Float64[np.ndarray, "time state"]
    observed: Bool[np.ndarray, "time state"]
    commands: dict[str, Float64[np.ndarray, " time"]]


def arrays_per_trajectory(
    name: str, values: Ragged, ndim: int, count: int | None = None, dtype: type = float
) -> list[np.ndarray]:
    """One array of `ndim` axes per trajectory; a single one serves all `count`.

    Raises:
        InputError: the numbers of axes, of arrays or the type of number is another;
            the message calls the argument `name`.
    """
    depth = _depth(values)
    if depth == ndim:
        return [_array(name, values, ndim, dtype)] * (count or 1)
    if depth != ndim + 1 or len(values) == 0:
        raise InputError(
            f"{name}: expected an array with {ndim} axes, or one for each trajectory; "
            f"got {depth} axes"
        )
    if count is not None and len(values) != count:
        raise InputError(
            f"{name}: expected one array for each of the {count} trajectories, "
            f"got {len(values)}"
        )
    return [
        _array(f"{name} of trajectory {i}", value, ndim, dtype)
        for i, value in enumerate(values)
    ]


def _depth(values: Any) -> int:
    if isinstance(values, list | tuple):
        return 1 + (_depth(values[0]) if values else 0)
    return np.ndim(values)


def _array(name: str, values: Any, ndim: int, dtype: type) -> np.ndarray:
    expected = "booleans" if dtype is bool else "numbers"
    try:
        array = np.array(values)
    except ValueError as error:
        raise InputError(f"{name}: expected rows of equal length") from error
    if array.ndim != ndim:
        raise InputError(f"{name}: expected {ndim} axes, got shape {array.shape}")
    if array.dtype.kind not in ("b" if dtype is bool else "fiu"):
        raise InputError(f"{name}: expected {expected}, got {array.dtype}")
    return array.astype(dtype)


def check_trajectory(
    name: str,
    channels: tuple[str, ...],
    samples: tuple[np.ndarray, np.ndarray, np.ndarray | None],
    commands: dict[str, np.ndarray],
) -> Trajectory:
    """A trajectory from its times, states and mask, and from its commands.

    Raises:
        InputError: they do not fit together, are not finite, or a time does not come
            after the one before it; the message calls the trajectory `name`.
    """
    times, states, observed = samples
    observed = np.ones_like(states, bool) if observed is None else observed
    for what, array, expected in (
        ("states", states, (len(times), len(channels))),
        ("observed", observed, states.shape),
        *((f"command {key!r}", c, times.shape) for key, c in commands.items()),
    ):
        if array.shape != expected:
            raise InputError(
                f"{what} of {name}: expected shape {expected} for {len(times)} times "
                f"and the channels {', '.join(channels)}; got {array.shape}"
            )
    if len(times) < 2:
        raise InputError(f"{name}: expected two or more samples, got {len(times)}")
    _check_finite(f"times of {name}", times)
    check_increasing(times, lambda row: f"times of {name}, row {row}")
    states = np.where(observed, states, 0.0)
    for column, channel in enumerate(channels):
        _check_finite(
            f"states of {name}, column {column} ({channel})",
            states[:, column],
            "; mark what is missing by observed=numpy.isfinite(states)",
        )
    for key, values in commands.items():
        _check_finite(f"command {key!r} of {name}", values)
    return Trajectory(times, states, observed, commands)


def check_increasing(
    times: Float64[np.ndarray, " time"], where: Callable[[int], str]
) -> None:
    """Refuse times that do not increase.

    Args:
        where: names the place of a row for the message.

    Raises:
        InputError: a time is not after the one before it.
    """
    late = np.flatnonzero(times[1:] <= times[:-1])
    if late.size:
        row = int(late[0]) + 1
        fault = "repeated" if times[row] == times[row - 1] else "out of order"
        raise InputError(
            f"{where(row)}: time {times[row]} after {times[row - 1]} is {fault}; "
            "expected increasing times, so sort the rows and drop repeats"
        )


def _check_finite(name: str, values: np.ndarray, remedy: str = "") -> None:
    wrong = np.flatnonzero(~np.isfinite(values))
    if wrong.size:
        row = wrong[0]
        raise InputError(
            f"{name}, row {row}: expected a finite number, got {values[row]}{remedy}"
        )


_HEADING = re.compile(r"(?P<name>.*?\S)\s*[\[(](?P<unit>[^\[\]()]*)[\])]")


def split_heading(heading: str) -> tuple[str, str | None]:
    """Name and unit of a heading such as `x [um]`; None where it states no unit."""
    match = _HEADING.fullmatch(heading.strip())
    if match is None:
        return heading.strip(), None
    return match["name"], match["unit"].strip()


def split_headings(headings: Sequence[str]) -> tuple[list[str], dict[str, str]]:
    """Names of all columns, and the units of those whose heading states one."""
    pairs = [split_heading(heading) for heading in headings]
    return [name for name, _ in pairs], {name: unit for name, unit in pairs if unit}


def table_columns(table: Any) -> dict[str, Float64[np.ndarray, " row"]]:
    """The columns of a table or mapping as numbers, by name; NaN where missing."""
    if isinstance(table, Mapping):
        columns = dict(table)
    elif hasattr(table, "column_names"):  # pyarrow
        columns = {name: table[name] for name in table.column_names}
    elif hasattr(table, "columns") and hasattr(table, "__getitem__"):
        columns = {name: table[name] for name in table.columns}
    elif hasattr(table, "__arrow_c_stream__"):
        return table_columns(_through_arrow(table))
    else:
        raise InputError(
            "from_table: expected a table of pandas, polars or pyarrow, or columns by "
            f"name, got a {type(table).__name__}"
        )
    return {str(name): _numbers(str(name), column) for name, column in columns.items()}


def _through_arrow(table: Any) -> Any:
    try:
        import pyarrow
    except ImportError as error:
        raise InputError(
            f"from_table: a {type(table).__name__} is read by pyarrow; install it by "
            "pip install pyarrow"
        ) from error
    return pyarrow.table(table)


def _numbers(name: str, column: Any) -> Float64[np.ndarray, " row"]:
    try:
        if hasattr(column, "isna"):  # pandas, whose NA is no number for NumPy
            return column.to_numpy(dtype=np.float64, na_value=np.nan)
        return np.asarray(column, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"from_table: column {name!r}: expected numbers, got "
            f"{' '.join(str(error).split())}"
        ) from error
