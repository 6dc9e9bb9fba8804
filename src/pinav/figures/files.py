"""Figures as files, whole or not at all, and the same bytes for the same figure."""

import contextlib
import dataclasses
from collections.abc import Iterator
from pathlib import Path

from matplotlib.figure import Figure

from pinav.figures.style import file_settings
from pinav.files import write_whole


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
    with file_settings(), _laid_out(figure):
        write_whole(
            files.png,
            lambda to: figure.savefig(
                to, format="png", dpi=150, metadata={"Software": None}
            ),
        )
        write_whole(
            files.svg,
            lambda to: figure.savefig(
                to, format="svg", dpi=150, metadata={"Date": None, "Creator": None}
            ),
        )
    return files


@contextlib.contextmanager
def _laid_out(figure: Figure) -> Iterator[None]:
    """The layout is found once, not again for every file: it is half of the work."""
    engine = figure.get_layout_engine()
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    try:
        yield
    finally:
        figure.set_layout_engine(engine)
