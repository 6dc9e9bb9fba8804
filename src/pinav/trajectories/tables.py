"""Columns of tables from other packages, and the names and units in their headings."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64

from pinav.errors import InputError

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
