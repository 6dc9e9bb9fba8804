"""Layout of a table in its file: title rows, header, a row of units, rows.

Text files and sheets of workbooks, of which values only are read, come to the same:
numbered rows of cells.
"""

import csv
import io
import re
import zipfile
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from pinav.errors import InputError
from pinav.recordings import units
from pinav.recordings.table import Table

DELIMITERS = ",\t;"
"""Delimiters of text files, told by the header; spaces where it has none of them."""

COMMENTS = ("#", "%")
"""Beginnings of comment lines, which may stand above the header."""

_COMMA = re.compile(r"\s*[-+]?\d+,\d+(?:[eE][-+]?\d+)?\s*")
_POINT = re.compile(r"\s*[-+]?\d*\.\d+(?:[eE][-+]?\d+)?\s*")
_SAMPLE = 50
"""Rows by which the width of a table is judged."""

Row = tuple[int, Sequence[Any]]
"""Number of a row in its file, and its cells."""


def read_delimited(
    text: str,
    *,
    skip: int = 0,
    below: int = 0,
    names: Sequence[str] | None = None,
    faults: dict[str, str] | None = None,
) -> Table:
    """The table of a text file with a header; unnamed columns are numbered from 0.

    Args:
        skip: lines above the header.
        names: names of the columns, where those of the header are not unique.
        faults: collects bad rows; the first one is refused if None.
    """
    lines = text.splitlines(keepends=True)[skip:]
    if not lines or not lines[0].strip():
        raise InputError(
            f"line {skip + 1}: expected the names of the columns, got nothing; "
            "export the file again"
        )
    lines[0] = header_text(lines[0])
    delimiter = delimiter_of(lines[0])
    if delimiter is None:
        lines, delimiter = ["\t".join(line.split()) + "\n" for line in lines], "\t"
    reader = csv.reader(lines, delimiter=delimiter, strict=True)
    rows: list[Row] = []
    try:
        for cells in reader:
            if not rows and names is None and all(map(is_number, cells)):
                rows.append((skip, [str(index) for index in range(len(cells))]))
            elif not rows:
                _check_header([name.strip() for name in names or cells], skip + 1)
            rows.append((skip + reader.line_num, cells))
    except csv.Error as error:
        raise InputError(f"line {skip + reader.line_num}: not CSV: {error}") from error
    kept = [rows[0], *rows[1 + below :]]
    decimal = delimiter != ","
    return table_of(kept, "line", names=names, decimal=decimal, faults=faults)


def delimiter_of(line: str) -> str | None:
    """The delimiter of the cells of a line; None for spaces."""
    delimiter = max(DELIMITERS, key=line.count)
    return delimiter if delimiter in line else None


def cells_of(line: str) -> list[str]:
    """The cells of a line of text."""
    delimiter = delimiter_of(line)
    if delimiter is None:
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]


def header_text(line: str) -> str:
    """A header without the sign of a comment."""
    return line.lstrip("".join(COMMENTS) + " ") if line.startswith(COMMENTS) else line


def rows_of_comments(lines: Sequence[str]) -> int:
    """Number of comment lines above the header, which may itself be a comment.

    `numpy.savetxt` writes the header as a comment above a row of as many numbers.
    """
    rest = (i for i, line in enumerate(lines) if not line.startswith(COMMENTS))
    count = next(rest, len(lines))
    if 0 < count < len(lines):
        cells, names = cells_of(lines[count]), cells_of(header_text(lines[count - 1]))
        if len(cells) == len(names) and all(map(is_number, cells)):
            return count - 1
    return count


def table_of(
    rows: Sequence[Row],
    place: str,
    *,
    names: Sequence[str] | None = None,
    decimal: bool = False,
    faults: dict[str, str] | None = None,
) -> Table:
    """The table of rows that are numbered as in the file; the first names the columns.

    Args:
        place: word for a row in messages.
    """
    number, first = rows[0]
    header = [str(c or "").strip() for c in first] if names is None else list(names)
    body = [
        (i, cells) for i, cells in rows[1:] if any(c not in ("", None) for c in cells)
    ]
    if decimal and names is None and _numbers_its_rows(header, body):
        header = ["", *header]
    _check_header(header, number, place)
    stated: dict[str, str] = {}
    notes: tuple[str, ...] = ()
    if body and _is_row_of_units(body[0][1]):
        line, cells = body.pop(0)
        stated = {n: str(c).strip() for n, c in zip(header, cells, strict=False) if c}
        notes = (f"{place} {line} states the units",)
    body = _of_width(body, len(header), place, faults)
    if not body:
        raise InputError(
            f"{place} {number}: the header is all there is; expected rows below it"
        )
    columns: dict[str, Sequence[Any]] = dict(
        zip(header, zip(*(cells for _, cells in body), strict=True), strict=True)
    )
    columns, joined = _without_thousands(columns)
    if joined:
        notes = (*notes, "signs between thousands were left out")
    columns, commas = _with_points(columns) if decimal else (columns, False)
    if commas:
        notes = (*notes, "decimal commas were read as points")
    return Table(
        {name: cells for name, cells in columns.items() if name},
        np.array([i for i, _ in body], np.int64),
        place,
        {name: unit for name, unit in stated.items() if name},
        faults,
        notes,
    )


def _numbers_its_rows(header: Sequence[str], body: Sequence[Row]) -> bool:
    """True if each row begins with a further number, as R writes tables."""
    longer = all(len(cells) == len(header) + 1 for _, cells in body)
    first = [str(cells[0]).strip('"') for _, cells in body]
    counted = first == [str(1 + i) for i in range(len(body))]
    return bool(body) and all(header) and longer and counted


def _check_header(header: Sequence[str], line: int, place: str = "line") -> None:
    for name in header:
        if name and header.count(name) > 1:
            raise InputError(
                f"{place} {line}: column {name!r} stands twice; rename or delete one"
            )


def _is_row_of_units(cells: Sequence[Any]) -> bool:
    words = [str(c).strip() for c in cells if c not in ("", None)]
    if not words or any(is_number(word) for word in words):
        return False
    known = [w for w in words if units.is_unit(w)]
    silent = [w for w in words if w.strip("()[]-– ") == "" or w[0] in "(["]
    return bool(known) and len(words) - len(silent) < 2 * len(known)


def _of_width(
    body: Sequence[Row], width: int, place: str, faults: dict[str, str] | None
) -> list[Row]:
    """The rows that have as many cells as the header; the others are bad.

    A last delimiter makes empty cells beyond the header, which do not count.
    """
    kept = []
    for number, cells in body:
        if not any(cell not in ("", None) for cell in cells[width:]):
            cells = cells[:width]
        if len(cells) == width:
            kept.append((number, cells))
            continue
        fault = (
            f"{place} {number}: expected {width} cells, as in the header, got "
            f"{len(cells)}; is the file cut short, or a comma in a number?"
        )
        if faults is None:
            raise InputError(fault)
        faults[f"{place} {number}"] = fault
    if body and len(kept) < 0.9 * len(body) and faults:
        raise InputError(next(iter(faults.values())))
    return kept


def _with_points(
    columns: dict[str, Sequence[Any]],
) -> tuple[dict[str, Sequence[Any]], bool]:
    """The columns with points for decimal commas, and whether there were any.

    Commas are decimal ones if numbers have them and none of them a point.
    """
    words = [c for cells in columns.values() for c in cells if isinstance(c, str)]
    if any(map(_POINT.fullmatch, words)) or not any(map(_COMMA.fullmatch, words)):
        return columns, False

    def in_one(cell: Any) -> Any:
        numeric = isinstance(cell, str) and _COMMA.fullmatch(cell)
        return cell.replace(",", ".") if numeric else cell

    return {n: [in_one(c) for c in cells] for n, cells in columns.items()}, True


_THOUSANDS = re.compile(r"\s*[-+]?\d{1,3}(,\d{3})+(\.\d*)?\s*")
_GROUPS = re.compile(r"\s*[-+]?\d{1,3}(['’\u00a0\u202f]\d{3})+([.,]\d*)?\s*")
_SURE = re.compile(r".*,\d{3}[.,].*")
"""A number with commas between thousands, one with other signs there, and one of the
first kind whose comma is no decimal one."""


def _without_thousands(
    columns: dict[str, Sequence[Any]],
) -> tuple[dict[str, Sequence[Any]], bool]:
    """The columns without thousands separators, and whether there were any.

    Commas separate thousands where all of them may do so and one of them must.
    """
    words = [c for cells in columns.values() for c in cells if isinstance(c, str)]
    commas = [w for w in words if _COMMA.fullmatch(w) or _THOUSANDS.fullmatch(w)]
    signs = "'’\u00a0\u202f" if any(map(_GROUPS.fullmatch, words)) else ""
    if any(map(_SURE.fullmatch, commas)) and all(map(_THOUSANDS.fullmatch, commas)):
        signs += ","
    if not signs:
        return columns, False

    def in_one(cell: Any) -> Any:
        if not isinstance(cell, str):
            return cell
        numeric = _GROUPS.fullmatch(cell) or _THOUSANDS.fullmatch(cell)
        return cell.translate(dict.fromkeys(map(ord, signs))) if numeric else cell

    return {n: [in_one(c) for c in cells] for n, cells in columns.items()}, True


def is_number(cell: Any) -> bool:
    """True for a cell with a number, written with a point or a comma."""
    if isinstance(cell, int | float):
        return True
    try:
        float(str(cell).strip().replace(",", "."))
    except ValueError:
        return False
    return True


def rows_above_header(rows: Sequence[Sequence[Any]]) -> int:
    """Number of title rows above the header, judged by the widths of the rows.

    The header is the first row as wide as most rows are; nothing is skipped where that
    row holds a number, because then the header itself is at fault.
    """
    widths = [
        max((i for i, cell in enumerate(row, 1) if cell not in ("", None)), default=0)
        for row in rows[:_SAMPLE]
    ]
    common = Counter(w for w in widths if w > 1).most_common(1)
    if not common or (rows and widths[0] >= common[0][0]):
        return 0
    first = next(i for i, w in enumerate(widths) if w >= common[0][0])
    return 0 if any(is_number(cell) for cell in rows[first] if cell) else first


_DAMAGED = (
    zipfile.BadZipFile,
    EOFError,
    KeyError,
    OSError,
    SyntaxError,  # what a parser of XML raises
    TypeError,
    ValueError,
)


def read_sheets(content: bytes) -> dict[str, list[tuple[Any, ...]]]:
    """The cells of every sheet, by its name."""
    import openpyxl
    from openpyxl.utils.exceptions import InvalidFileException

    try:
        book = openpyxl.load_workbook(
            io.BytesIO(content), read_only=True, data_only=True, keep_links=False
        )
        return {s.title: [tuple(row) for row in _cells(s)] for s in book.worksheets}
    except (InvalidFileException, *_DAMAGED) as error:
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise InputError(
            f"damaged workbook: {reason}; copy it from its origin again"
        ) from error


def _cells(sheet: Any) -> Iterator[tuple[Any, ...]]:
    sheet.reset_dimensions()  # which some writers state wrongly
    yield from sheet.iter_rows(values_only=True)


def sheet_table(
    content: bytes, name: str | None, skip: int | None, faults: dict[str, str] | None
) -> Table:
    """The table on a sheet of a workbook, or on the only one."""
    sheets = {name: rows for name, rows in read_sheets(content).items() if rows}
    names = ", ".join(map(repr, sheets)) or "none with cells"
    if name is None and len(sheets) != 1:
        raise InputError(f"sheets {names}: give one of them as sheet")
    name = next(iter(sheets)) if name is None else name
    if name not in sheets:
        raise InputError(f"sheet: expected one of {names}; got {name!r}")
    rows = sheets[name]
    skip = rows_above_header(rows) if skip is None else skip
    if skip >= len(rows):
        raise InputError(f"skip: sheet {name!r} has {len(rows)} rows; got {skip}")
    width = max(map(len, rows[skip:]))
    numbered: list[Row] = [
        (i, (*row, *[None] * (width - len(row))))
        for i, row in enumerate(rows[skip:], skip + 1)
    ]
    return table_of(numbered, f"sheet {name!r}, row", decimal=True, faults=faults)
