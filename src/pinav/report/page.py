"""One self-contained HTML page: opens offline and refers to nothing outside itself.

Whatever comes from data is escaped; images are embedded.
"""

import abc
import base64
import dataclasses
import math
import re
from collections.abc import Sequence
from html import escape
from pathlib import Path

from pinav.errors import InputError

Cell = str | float | int | None
"""A table cell; `number` formats what is not text."""

_MEDIA_TYPES = {".png": "image/png", ".svg": "image/svg+xml", ".gif": "image/gif"}
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_NUMBER = re.compile(r"[-−+±<>≤≥≈~ ]*\d[\d.,\s×·⁻⁰¹²³⁴⁵⁶⁷⁸⁹eE+−-]*[%×]?")
_WORDS_FOR_NUMBERS = frozenset({"", "–", "diverged"})


def number(value: float | int | None, digits: int = 4) -> str:
    """A number as a reader wants it, to `digits` significant digits.

    Integers are exact, what is not finite is "diverged", None is a dash, and very
    large or small numbers are written as a power of ten.
    """
    if value is None:
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
        rows: the cells of each row.
        caption: what the table shows.

    Raises:
        InputError: a row has not as many cells as the header.
    """

    header: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    caption: str = ""

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
            all(map(_looks_numeric, column)) for column in zip(*rows, strict=True)
        ] or [False] * len(self.header)
        caption = f"<caption>{escape(self.caption)}</caption>" if self.caption else ""
        head = _row("th", self.header, numeric)
        body = "\n".join(_row("td", row, numeric) for row in rows)
        return (
            f'<div class="wide"><table>{caption}\n<thead>{head}</thead>\n'
            f"<tbody>\n{body}\n</tbody></table></div>"
        )


def _cell_text(cell: Cell) -> str:
    return cell if isinstance(cell, str) else number(cell)


def _looks_numeric(text: str) -> bool:
    return text in _WORDS_FOR_NUMBERS or _NUMBER.fullmatch(text) is not None


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
        path: the file.
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
            data = base64.b64encode(path.read_bytes()).decode("ascii")
        except OSError as error:
            reason = error.strerror or error
            raise InputError(f"image {path}: cannot be read: {reason}") from error
        source = f"data:{_MEDIA_TYPES[path.suffix.lower()]};base64,{data}"
        caption = f"<figcaption>{escape(self.caption)}</figcaption>"
        return (
            f'<figure><img src="{source}" alt="{escape(self.alt)}" '
            f'style="width: {self.width:.0%}">'
            f"{caption if self.caption else ''}</figure>"
        )


@dataclasses.dataclass(frozen=True)
class Section:
    """A heading and what stands below it.

    Attributes:
        heading: also its line in the table of contents.
        blocks: in reading order.
    """

    heading: str
    blocks: Sequence[AbstractBlock]


def render(title: str, subtitle: str, sections: Sequence[Section]) -> str:
    """The whole page as HTML text, to be written as UTF-8.

    Args:
        title: the heading, also in the title bar.
        subtitle: one line below it, such as what was run and when.
        sections: in reading order.

    Raises:
        InputError: an image cannot be read.
    """
    contents = "\n".join(
        f'<li><a href="#section-{index}">{escape(section.heading)}</a></li>'
        for index, section in enumerate(sections, start=1)
    )
    body = "\n".join(
        _section(index, section) for index, section in enumerate(sections, start=1)
    )
    return _PAGE.format(
        style=_STYLE,
        title=escape(title),
        subtitle=escape(subtitle),
        contents=contents,
        body=body,
    )


def _section(index: int, section: Section) -> str:
    blocks = "\n".join(block.html() for block in section.blocks)
    heading = escape(section.heading)
    return f'<section id="section-{index}">\n<h2>{heading}</h2>\n{blocks}\n</section>'


_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<header>
<h1>{title}</h1>
<p class="subtitle">{subtitle}</p>
</header>
<nav aria-label="Contents">
<ol>
{contents}
</ol>
</nav>
<main>
{body}
</main>
</body>
</html>
"""

_STYLE = """
:root {
  --ground: #ffffff; --ink: #1b1f24; --soft: #59636e; --line: #d5dbe1;
  --card: #f5f7f9; --accent: #0063a0;
}
@media (prefers-color-scheme: dark) {
  :root {
    --ground: #14181d; --ink: #e4e8ec; --soft: #9aa5b1; --line: #333c46;
    --card: #1d232a; --accent: #6cb8ee;
  }
}
* { box-sizing: border-box; }
body {
  margin: 0 auto; max-width: 60rem; padding: 2.5rem 1.25rem 4rem;
  background: var(--ground); color: var(--ink); line-height: 1.55;
  font-family: system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue",
    Arial, sans-serif;
}
h1, h2 { line-height: 1.25; text-wrap: balance; overflow-wrap: anywhere; }
h1 { font-size: 1.9rem; margin: 0; }
h2 {
  font-size: 1.3rem; margin: 2.75rem 0 0.75rem; padding-bottom: 0.3rem;
  border-bottom: 1px solid var(--line);
}
p { max-width: 46rem; margin: 0.75rem 0; overflow-wrap: anywhere; }
.subtitle { color: var(--soft); margin-top: 0.35rem; }
a { color: var(--accent); text-decoration: none; }
a:hover, a:focus-visible { text-decoration: underline; }
nav {
  margin-top: 1.5rem; padding: 0.75rem 1rem; background: var(--card);
  border-radius: 8px; font-size: 0.92rem;
}
nav ol { margin: 0; padding-left: 1.4rem; columns: 16rem; }
.wide { overflow-x: auto; margin: 1.25rem 0; }
table {
  border-collapse: collapse; font-size: 0.92rem;
  border-top: 2px solid var(--ink); border-bottom: 2px solid var(--ink);
}
caption {
  text-align: left; padding-bottom: 0.5rem; color: var(--soft);
  position: sticky; left: 0; max-width: min(46rem, calc(100vw - 2.5rem));
}
td:first-child { min-width: 8rem; }
th, td { padding: 0.35rem 1rem; text-align: left; }
th:first-child, td:first-child { padding-left: 0.25rem; }
th { font-weight: 600; vertical-align: bottom; }
thead tr { border-bottom: 1px solid var(--ink); }
tbody tr + tr { border-top: 1px solid var(--line); }
.number {
  text-align: right;
  font-variant-numeric: tabular-nums; white-space: nowrap;
}
figure {
  margin: 1.5rem 0; padding: 1rem; background: #ffffff;
  border: 1px solid var(--line); border-radius: 8px;
}
figure { overflow-x: auto; }
figure img { display: block; margin: 0 auto; height: auto; }
@media (max-width: 40rem) {
  figure img { width: auto !important; min-width: 34rem; max-width: none; }
  figcaption { position: sticky; left: 0; max-width: calc(100vw - 4.5rem); }
}
figcaption { margin-top: 0.75rem; color: #4a535d; font-size: 0.9rem; }
pre {
  overflow-x: auto; padding: 0.9rem 1rem; background: var(--card);
  white-space: pre-wrap; overflow-wrap: anywhere;
  border: 1px solid var(--line); border-radius: 8px; font-size: 0.85rem;
  line-height: 1.45;
}
code { font-family: ui-monospace, Menlo, Consolas, "DejaVu Sans Mono", monospace; }
@media print {
  :root {
    --ground: #ffffff; --ink: #000000; --soft: #444444; --line: #bbbbbb;
    --card: #ffffff; --accent: #000000;
  }
  body { max-width: none; padding: 0; font-size: 10pt; }
  nav { border: 1px solid var(--line); }
  h2 { break-after: avoid; }
  figure, tr, pre { break-inside: avoid; }
  figure { border: 0; padding: 0; }
  pre { white-space: pre-wrap; }
  .wide { overflow: visible; }
}
"""
