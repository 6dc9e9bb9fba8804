"""Blocks of a report as plain text."""

from collections.abc import Sequence

from pinav.report import Code, Paragraph, Section, Table, number

DIGITS, MOST_ROWS = 3, 25
"""Significant digits on a terminal, and the rows of a table that it shows."""


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


def sections_text(sections: Sequence[Section]) -> str:
    """What a terminal shows of a report: paragraphs, tables and code, no pictures.

    A section of pictures alone is left out. A long table loses its last rows, and says
    so.
    """
    return "\n\n".join(
        f"{section.heading}\n{'-' * len(section.heading)}\n{text}"
        for section in sections
        if (text := _section(section))
    )


def _section(section: Section) -> str:
    parts: list[str] = []
    for block in section.blocks:
        if isinstance(block, Paragraph | Code):
            parts.append(block.text)
        elif isinstance(block, Table):
            parts.append(f"\n{as_text(_beginning(block))}\n")
    return "\n".join(parts).strip().replace("\n\n\n", "\n\n")


def _beginning(table: Table) -> Table:
    left_out = len(table.rows) - MOST_ROWS
    if left_out <= 0:
        return table
    note = f"{left_out} more rows stand in the report. {table.caption}"
    return Table(table.header, table.rows[:MOST_ROWS], note)
