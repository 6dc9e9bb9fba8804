"""Blocks of a report, as one self-contained HTML page and as plain text.

The page opens offline and refers to nothing outside itself: whatever comes from data is
escaped, images are embedded.
"""

import abc
import base64
import dataclasses
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import TypeVar

from pinav.errors import InputError

Item = TypeVar("Item")

Cell = str | float | int | None
"""A table cell; `number` formats what is not text."""

_MEDIA_TYPES = {".png": "image/png", ".svg": "image/svg+xml", ".gif": "image/gif"}
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_NUMBER = re.compile(
    r"[-−+±<>≤≥≈~ ]*\d[\d.,\s×·⁻⁰¹²³⁴⁵⁶⁷⁸⁹eE+−-]*[%×]?"
    r"( \([-−\d.]+–([-−\d.]+|∞)\))?"  # with its interval
)
_WORDS_FOR_NUMBERS = frozenset({"", "–", "diverged"})


def number(value: float | int | None, digits: int = 4) -> str:
    """A number as a reader wants it, to `digits` significant digits.

    Integers are exact, what is infinite is "diverged", None and NaN, which are not
    defined, are a dash, and very large or small numbers are written as a power of ten.
    """
    if value is None or math.isnan(value):
        return "–"
    if isinstance(value, int):
        return f"{value}".replace("-", "−")
    if not math.isfinite(value):
        return "diverged"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    power = int(exponent)
    if value == 0.0:
        text = "0"
    elif -4 < power < max(digits, 5):
        text = f"{value:.{max(digits - 1 - power, 0)}f}"
    else:
        text = f"{mantissa} × 10{str(power).translate(_SUPERSCRIPTS)}"
    return text.replace("-", "−")


def percent(fraction: float | None) -> float | None:
    """A fraction in percent; None stays so."""
    return None if fraction is None else 100 * fraction


def quantity(value: float | int | None, unit: str, digits: int = 3) -> str:
    """A number with its unit; dimensionless ("1") and unknown ("?") ones are left out.

    Args:
        unit: such as "um".
        digits: significant digits.
    """
    return number(value, digits) + ("" if unit in NO_UNIT else f" {unit}")


def capitalise(sentence: str) -> str:
    """A sentence with a capital at its start; names and units in it keep theirs."""
    return sentence[:1].upper() + sentence[1:]


def heading(name: str, unit: str) -> str:
    """The heading of a column of numbers in a unit, such as "x [um]"."""
    return name if unit in NO_UNIT else f"{name} [{unit}]"


NO_UNIT = ("", "1", "?")
"""Units that are not printed."""


def measured(value: float | None, sd: float | None) -> str:
    """A number to the last digit that its standard deviation leaves, and that.

    Args:
        sd: its standard deviation; None where there is none.
    """
    if value is None or sd is None or not (0 < sd < math.inf) or value == 0.0:
        return number(value, 6) + ("" if sd is None else f" ± {number(sd, 2)} (sd)")
    orders = math.floor(math.log10(abs(value))) - math.floor(math.log10(sd))
    digits = min(max(orders + 2, 1), 8)
    return f"{number(value, digits)} ± {number(sd, 2)} (sd)"


class AbstractBlock(abc.ABC):
    """One piece of a section."""

    @abc.abstractmethod
    def html(self) -> str:
        """The block as HTML, everything that came from outside escaped."""


@dataclasses.dataclass(frozen=True)
class Paragraph(AbstractBlock):
    """Plain text.

    Attributes:
        text: the words; markup in them is shown, not obeyed.
    """

    text: str

    def html(self) -> str:
        return f"<p>{escape(self.text)}</p>"


@dataclasses.dataclass(frozen=True)
class Link(AbstractBlock):
    """A link to a file that lies beside the page.

    Attributes:
        target: name of the file.
    """

    target: str
    text: str

    def html(self) -> str:
        return f'<p><a href="{escape(self.target)}">{escape(self.text)}</a></p>'


@dataclasses.dataclass(frozen=True)
class Code(AbstractBlock):
    """Text in a fixed-width font, its line breaks kept.

    Attributes:
        text: such as a configuration file.
    """

    text: str

    def html(self) -> str:
        return f"<pre><code>{escape(self.text)}</code></pre>"


@dataclasses.dataclass(frozen=True)
class Table(AbstractBlock):
    """A table; a column of numbers is set flush right.

    Attributes:
        header: name of each column.
        caption: what the table shows.
        name: of a file that keeps it, too, without ending; empty for none.

    Raises:
        InputError: a row has not as many cells as the header.
    """

    header: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    caption: str = ""
    name: str = ""

    @classmethod
    def of(
        cls,
        items: Iterable[Item],
        columns: Mapping[str, Callable[[Item], Cell]],
        caption: str = "",
        name: str = "",
    ) -> "Table":
        """A table with a row for each item.

        Args:
            items: what the rows are about.
            columns: the cell of an item in each column, by the name of the column.
            caption: what the table shows.
            name: of a file that keeps it, too, without ending; empty for none.
        """
        rows = [[cell(item) for cell in columns.values()] for item in items]
        return cls(tuple(columns), rows, caption, name)

    def __post_init__(self) -> None:
        for index, row in enumerate(self.rows):
            if len(row) != len(self.header):
                raise InputError(
                    f"Table row {index}: expected {len(self.header)} cells, as in the "
                    f"header, got {len(row)}"
                )

    def html(self) -> str:
        rows = [[_cell_text(cell) for cell in row] for row in self.rows]
        numeric = [
            all(t in _WORDS_FOR_NUMBERS or _NUMBER.fullmatch(t) for t in column)
            for column in zip(*rows, strict=True)
        ] or [False] * len(self.header)
        caption = f"<caption>{escape(self.caption)}</caption>" if self.caption else ""
        head = _row("th", self.header, numeric)
        body = "\n".join(_row("td", row, numeric) for row in rows)
        return (
            f'<div class="wide"><table>{caption}\n<thead>{head}</thead>\n'
            f"<tbody>\n{body}\n</tbody></table></div>"
        )


def _cell_text(cell: Cell, digits: int = 4) -> str:
    return cell if isinstance(cell, str) else number(cell, digits)


def _row(tag: str, cells: Sequence[str], numeric: Sequence[bool]) -> str:
    kinds = (' class="number"' if flag else "" for flag in numeric)
    scope = ' scope="col"' if tag == "th" else ""
    inner = "".join(
        f"<{tag}{scope}{kind}>{escape(cell)}</{tag}>"
        for cell, kind in zip(cells, kinds, strict=True)
    )
    return f"<tr>{inner}</tr>"


@dataclasses.dataclass(frozen=True)
class Image(AbstractBlock):
    """A PNG, SVG or GIF file, embedded in the page.

    Attributes:
        alt: what it shows, for those who do not see it.
        caption: the words below it.
        width: share of the page's width, in (0, 1].

    Raises:
        InputError: the file is neither PNG, SVG nor GIF, or `width` is out of range
            (when made); the file cannot be read (when rendered).
    """

    path: str | Path
    alt: str
    caption: str = ""
    width: float = 1.0

    def __post_init__(self) -> None:
        if Path(self.path).suffix.lower() not in _MEDIA_TYPES:
            raise InputError(f"image {self.path}: expected a .png, .svg or .gif file")
        if not 0.0 < self.width <= 1.0:
            raise InputError(f"image width: expected within (0, 1], got {self.width}")

    def html(self) -> str:
        path = Path(self.path)
        try:
            content = path.read_bytes()
        except OSError as error:
            reason = error.strerror or error
            raise InputError(f"image {path}: cannot be read: {reason}") from error
        return figure_html(content, path.suffix, self.alt, self.caption, self.width)


def figure_html(
    content: bytes, suffix: str, alt: str, caption: str, width: float
) -> str:
    """The content of an image file as HTML, embedded."""
    data = base64.b64encode(content).decode("ascii")
    source = f"data:{_MEDIA_TYPES[suffix.lower()]};base64,{data}"
    words = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return (
        f'<figure><img src="{source}" alt="{escape(alt)}" '
        f'style="width: {width:.0%}">{words}</figure>'
    )


@dataclasses.dataclass(frozen=True)
class Section:
    """A heading and what stands below it.

    Attributes:
        heading: also its line in the table of contents.
    """

    heading: str
    blocks: Sequence[AbstractBlock]


def render(title: str, subtitle: str, sections: Sequence[Section]) -> str:
    """The whole page as HTML text, to be written as UTF-8.

    Args:
        title: the heading, also in the title bar.
        subtitle: one line below it, such as what was run and when.

    Raises:
        InputError: an image cannot be read.
    """
    contents = "\n".join(
        f'<li><a href="#section-{index}">{escape(section.heading)}</a></li>'
        for index, section in enumerate(sections, start=1)
    )
    body = "\n".join(
        f'<section id="section-{index}">\n<h2>{escape(section.heading)}</h2>\n'
        + "\n".join(block.html() for block in section.blocks)
        + "\n</section>"
        for index, section in enumerate(sections, start=1)
    )
    return _source("page.html").format(
        style="\n" + _source("page.css"),
        title=escape(title),
        subtitle=escape(subtitle),
        contents=contents,
        body=body,
    )


def _source(name: str) -> str:
    """A file that stands beside this module."""
    return files("pinav.report").joinpath(name).read_text(encoding="utf-8")


DIGITS, MOST_ROWS = 3, 25
"""Significant digits on a terminal, and the rows of a table that it shows."""


def as_text(table: Table) -> str:
    """The table with aligned columns, its caption below."""
    cells = [[_cell_text(cell, DIGITS) for cell in row] for row in table.rows]
    rows = [list(table.header), *cells]
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
        if (text := _section_text(section))
    )


def _section_text(section: Section) -> str:
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
