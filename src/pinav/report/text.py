"""Tables of a report as plain text."""

from pinav.report import Table, number

DIGITS = 3
"""Significant digits on a terminal."""


def as_text(table: Table) -> str:
    """The table with aligned columns, its caption below."""
    rows = [list(table.header)]
    for row in table.rows:
        rows.append([c if isinstance(c, str) else number(c, DIGITS) for c in row])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        "  ".join(
            cell.ljust(width) if index == 0 else cell.rjust(width)
            for index, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
    return "\n".join([*lines, *([f"({table.caption})"] if table.caption else [])])
