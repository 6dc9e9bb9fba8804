"""Figures as files, whole or not at all, and the same bytes for the same figure."""

import contextlib
import dataclasses
import io
from collections.abc import Iterator
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from pinav.figures.style import file_settings
from pinav.files import write_whole

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
