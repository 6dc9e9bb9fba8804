"""Sheets of a workbook as rows of cells: values only, nothing is computed."""

import io
import zipfile
from collections.abc import Iterator
from typing import Any

from pinav.errors import InputError
from pinav.recordings.layout import Layout, Row, rows_above_header, table_of
from pinav.recordings.table import Table

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
    """The cells of every sheet, by its name.

    Raises:
        InputError: the workbook is damaged.
    """
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


def sheet_table(content: bytes, layout: Layout, faults: dict[str, str] | None) -> Table:
    """The table on the sheet that the layout names, or on the only one.

    Raises:
        InputError: the workbook is damaged, or it is not clear which sheet is meant.
    """
    sheets = {name: rows for name, rows in read_sheets(content).items() if rows}
    names = ", ".join(map(repr, sheets)) or "none with cells"
    if layout.sheet is None and len(sheets) != 1:
        raise InputError(f"sheets {names}: give one of them as sheet")
    name = next(iter(sheets)) if layout.sheet is None else layout.sheet
    if name not in sheets:
        raise InputError(f"sheet: expected one of {names}; got {name!r}")
    rows = sheets[name]
    skip = rows_above_header(rows) if layout.skip is None else layout.skip
    if skip >= len(rows):
        raise InputError(f"skip: sheet {name!r} has {len(rows)} rows; got {skip}")
    width = max(map(len, rows[skip:]))
    numbered: list[Row] = [
        (i, (*row, *[None] * (width - len(row))))
        for i, row in enumerate(rows[skip:], skip + 1)
    ]
    return table_of(numbered, f"sheet {name!r}, row", decimal=True, faults=faults)
