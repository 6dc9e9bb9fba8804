"""Tables of a tracker's file: named columns, and where each row stands in the file."""

import csv
import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, final

import numpy as np
from jaxtyping import Float64, Int64

from pinav.errors import InputError

DELIMITERS = ",\t;"
"""What may separate the cells of a text file; the header tells which it is."""

_LOST = ("", "nan", "na", "n/a", "none", "null")
"""Words for a number that is not there, in lower case."""


@final
@dataclasses.dataclass(frozen=True, eq=False)
class Table:
    """Columns of cells, which may be text, numbers or empty.

    Attributes:
        columns: cells of each column, by its name.
        rows: number of each row in the file, for messages.
        place: what a row is called, such as "line" or "sheet 'Robot 1', row".
    """

    columns: Mapping[str, Sequence[Any] | np.ndarray]
    rows: Int64[np.ndarray, " row"]
    place: str = "line"

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.rows)

    def row(self, row: int) -> str:
        """Where a row stands, for a message."""
        return f"{self.place} {self.rows[row]}"

    def where(self, row: int, column: str) -> str:
        """Where a cell stands, for a message."""
        return f"{self.row(row)}, column {column!r}"

    def column(self, name: str) -> Sequence[Any] | np.ndarray:
        """The cells of a column.

        Raises:
            InputError: there is none of that name.
        """
        if name not in self.columns:
            raise InputError(
                f"{self.header}: column {name!r} is missing; got "
                f"{', '.join(map(str, self.columns)) or 'none'}; add it, or name "
                "another by a column map"
            )
        return self.columns[name]

    @property
    def header(self) -> str:
        """Where the names of the columns stand, for a message."""
        return "header" if self.place == "line" else self.place.removesuffix(", row")

    def numbers(self, name: str, *, lost: bool = False) -> Float64[np.ndarray, " row"]:
        """The numbers of a column.

        Args:
            name: of the column.
            lost: whether a cell may be empty or NaN, which becomes NaN.

        Raises:
            InputError: the column is missing, or a cell is no finite number.
        """
        cells = self.column(name)
        values = _as_floats(cells)
        if values is None or not (lost or np.isfinite(values).all()):
            values = np.array(
                [
                    self._number(row, name, cell, lost=lost)
                    for row, cell in enumerate(cells)
                ],
                np.float64,
            )
        return values

    def _number(self, row: int, name: str, cell: Any, *, lost: bool) -> float:
        text = "" if cell is None else str(cell).strip()
        empty = text.lower() in _LOST
        if empty and lost:
            return math.nan
        try:
            number = math.nan if "_" in text else float(text)
        except ValueError:
            number = math.nan
        if math.isfinite(number):
            return number
        shown = repr(text) if text else "an empty cell"
        remedy = (
            "write decimals with a point"
            if "," in text
            else "correct the cell"
            if lost
            else "give its value or delete the row"
        )
        raise InputError(
            f"{self.where(row, name)}: expected a finite number, got {shown}; {remedy}"
        )

    def whole_numbers(
        self, name: str, *, least: int | None = None
    ) -> Int64[np.ndarray, " row"]:
        """The whole numbers of a column, such as frames.

        Args:
            name: of the column.
            least: the smallest that is allowed, if there is one.

        Raises:
            InputError: the column is missing, or a cell is no such number.
        """
        values = self.numbers(name)
        wrong = (values != np.round(values)) | (np.abs(values) > 2.0**53)
        if least is not None:
            wrong |= values < least
        if wrong.any():
            row = int(np.argmax(wrong))
            expected = "a whole number" + ("" if least is None else f" >= {least}")
            raise InputError(
                f"{self.where(row, name)}: expected {expected}, got {values[row]:g}; "
                "correct the cell or delete the row"
            )
        return values.astype(np.int64)

    def labels(self, name: str) -> list[str]:
        """The words of a column that tells things apart; 3.0 and 3 are one word.

        Raises:
            InputError: the column is missing, or a cell is empty.
        """
        words = [_label(cell) for cell in self.column(name)]
        if "" in words:
            row = words.index("")
            raise InputError(
                f"{self.where(row, name)}: expected a name or a number, got an empty "
                "cell; fill it or delete the row"
            )
        return words

    def taken(self, chosen: np.ndarray) -> "Table":
        """The rows at these indices, or where this mask is true."""
        columns = {
            name: np.asarray(cells, None if isinstance(cells, np.ndarray) else object)[
                chosen
            ]
            for name, cells in self.columns.items()
        }
        return Table(columns, self.rows[chosen], self.place)


def _as_floats(cells: Sequence[Any] | np.ndarray) -> np.ndarray | None:
    """All cells at once as numbers, or None where one of them needs a closer look."""
    if isinstance(cells, np.ndarray) and cells.dtype.kind in "fiub":
        values = cells.astype(np.float64)
        return None if np.isinf(values).any() else values
    if any(isinstance(cell, str) and "_" in cell for cell in cells):
        return None
    try:
        values = np.array(cells, np.float64)
    except (TypeError, ValueError):
        return None
    return None if values.ndim != 1 or np.isinf(values).any() else values


def _label(cell: Any) -> str:
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return ""
    if isinstance(cell, float | np.floating) and float(cell).is_integer():
        cell = int(cell)
    text = str(cell).strip()
    whole, point, zeros = text.partition(".")
    return whole if point and whole.isdigit() and not zeros.strip("0") else text


def read_delimited(
    text: str, *, skip: int = 0, below: int = 0, names: Sequence[str] | None = None
) -> Table:
    """The table of a text file whose first line names the columns.

    Args:
        text: the file.
        skip: lines above the header.
        below: lines between the header and the numbers, which are skipped too.
        names: of the columns, where those of the header are not unique.

    Raises:
        InputError: there is no header or no row, a name stands twice, or a row has
            not as many cells as the header.
    """
    lines = text.splitlines(keepends=True)[skip:]
    if not lines or not lines[0].strip():
        raise InputError(
            f"line {skip + 1}: expected the names of the columns, got nothing; "
            "export the file again"
        )
    delimiter = max(DELIMITERS, key=lines[0].count)
    reader = csv.reader(lines, delimiter=delimiter, strict=True)
    try:
        stated = [name.strip() for name in next(reader)]
        header = stated if names is None else list(names)
        _check_header(header, skip + 1)
        rows, numbers = _rows(reader, header, skip, below)
    except csv.Error as error:
        raise InputError(f"line {skip + reader.line_num}: not CSV: {error}") from error
    if not rows:
        raise InputError(
            f"line {skip + 1}: the header is all there is; expected rows below it"
        )
    columns = dict(zip(header, zip(*rows, strict=True), strict=True))
    return Table({n: c for n, c in columns.items() if n}, np.array(numbers, np.int64))


def _check_header(header: Sequence[str], line: int) -> None:
    for name in header:
        if name and header.count(name) > 1:
            raise InputError(
                f"line {line}: column {name!r} stands twice; rename or delete one"
            )


def _rows(
    reader: Any, header: Sequence[str], skip: int, below: int
) -> tuple[list[list[str]], list[int]]:
    """The rows that are not empty, and the line of each."""
    rows, numbers = [], []
    for index, cells in enumerate(reader):
        if index < below or not any(cells):
            continue
        if len(cells) != len(header):
            raise InputError(
                f"line {skip + reader.line_num}: expected {len(header)} cells, as in "
                f"the header, got {len(cells)}; is the file cut short, or a comma in "
                "a number?"
            )
        rows.append(cells)
        numbers.append(skip + reader.line_num)
    return rows, numbers
