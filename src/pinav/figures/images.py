"""Figures as blocks of a page: saved beside it, then embedded."""

import dataclasses
from collections.abc import Callable
from html import escape
from pathlib import Path

from matplotlib.figure import Figure

from pinav.figures.files import save_figure, svg_text
from pinav.report.page import AbstractBlock, Image, Section, figure_html


@dataclasses.dataclass(frozen=True)
class Picture(AbstractBlock):
    """A figure with its words, drawn when somebody looks at it.

    Attributes:
        name: of its files, without ending.
        draw: draws it.
        caption: the words below it.
        alt: what it shows, for those who do not see it; the first sentence of the
            caption unless given.
        width: share of the page's width, in (0, 1].
        has_many_points: the page shows it as PNG, because SVG would be too large.
    """

    name: str
    draw: Callable[[], Figure]
    caption: str
    alt: str = ""
    width: float = 1.0
    has_many_points: bool = False

    @property
    def description(self) -> str:
        """What it shows: the words for it, or the first sentence of the caption."""
        return self.alt or self.caption.partition(". ")[0]

    def html(self) -> str:
        drawn = svg_text(self.draw()).encode()
        return figure_html(drawn, ".svg", self.description, self.caption, self.width)

    def saved(self, folder: Path) -> Image:
        """The figure, written into a folder as PNG and SVG."""
        files = save_figure(self.draw(), folder, self.name)
        shown = files.png if self.has_many_points else files.svg
        return Image(shown, self.description, self.caption, self.width)


@dataclasses.dataclass(frozen=True)
class Movie(AbstractBlock):
    """An animation with its words, drawn when its page is written.

    Attributes:
        name: name of its file, without ending.
        write: writes it to a file and returns that.
        caption: the words below it.
    """

    name: str
    write: Callable[[Path], Path]
    caption: str

    def html(self) -> str:
        """The words alone: a movie needs a folder."""
        return f"<p>{escape(self.caption)}</p>"


class Figures:
    """The folder of the figures of a run.

    Attributes:
        folder: where the files are written.
    """

    def __init__(self, run: Path) -> None:
        self.folder = run / "figures"

    def saved(self, section: Section) -> Section:
        """The section with its pictures and movies drawn and written."""
        return Section(section.heading, [self._saved(b) for b in section.blocks])

    def _saved(self, block: AbstractBlock) -> AbstractBlock:
        if isinstance(block, Picture):
            return block.saved(self.folder)
        if isinstance(block, Movie):
            file = block.write(self.folder / f"{block.name}.gif")
            return Image(file, block.caption, block.caption)
        return block
