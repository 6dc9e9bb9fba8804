"""Figures as files and as blocks of a page."""

import contextlib
import dataclasses
import io
from collections.abc import Callable, Iterator
from html import escape
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from pinav.figures.style import file_settings
from pinav.files import write_whole
from pinav.report.page import AbstractBlock, Image, Section, figure_html

DPI = 150


@dataclasses.dataclass(frozen=True)
class FigureFiles:
    """Where one figure was written.

    Attributes:
        png: raster image, 150 dots per inch.
        svg: vector image, its text as text.
    """

    png: Path
    svg: Path


def save_figure(figure: Figure, folder: str | Path, name: str) -> FigureFiles:
    """Write `name.png` and `name.svg`; the same figure gives the same bytes.

    Each file appears whole or not at all: it is written under a temporary name.

    Args:
        figure: what to write.
        folder: where; made if it is not there.
        name: file name without its ending.

    Raises:
        OSError: the folder cannot be made or written.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    files = FigureFiles(folder / f"{name}.png", folder / f"{name}.svg")
    with file_settings(), _drawing(figure):
        raster, vector = FigureCanvasAgg(figure), FigureCanvasSVG(figure)
        write_whole(
            files.png, lambda to: raster.print_png(to, metadata={"Software": None})
        )
        write_whole(
            files.svg,
            lambda to: vector.print_svg(to, metadata={"Date": None, "Creator": None}),
        )
    return files


def svg_text(figure: Figure) -> str:
    """The figure as SVG, as `save_figure` writes it."""
    text = io.StringIO()
    with file_settings(), _drawing(figure):
        metadata = {"Date": None, "Creator": None}
        FigureCanvasSVG(figure).print_svg(text, metadata=metadata)
    return text.getvalue()


@contextlib.contextmanager
def _drawing(figure: Figure) -> Iterator[None]:
    """The layout is found once, not again for every file: it is half of the work.

    For the same reason the canvases write by themselves: `Figure.savefig` draws twice,
    once to find the layout.
    """
    engine, canvas, dpi = figure.get_layout_engine(), figure.canvas, figure.dpi
    figure.dpi = DPI
    if figure.axes and engine is not None:  # as `Figure.draw` does
        engine.execute(figure)  # `draw_without_rendering` would draw besides
    figure.set_layout_engine("none")
    try:
        yield
    finally:
        figure.set_layout_engine(engine)
        figure.set_canvas(canvas)
        figure.dpi = dpi


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


def save_pictures(section: Section, run: Path) -> Section:
    """The section with its pictures and movies drawn, and written into a run."""
    folder, blocks = run / "figures", []
    for block in section.blocks:
        if isinstance(block, Picture):
            block = block.saved(folder)
        elif isinstance(block, Movie):
            file = block.write(folder / f"{block.name}.gif")
            block = Image(file, block.caption, block.caption)
        blocks.append(block)
    return Section(section.heading, blocks)
