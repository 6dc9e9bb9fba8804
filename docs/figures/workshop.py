"""Runs that figures are made of, each made once, and pictures as small files."""

import io
import shutil
from collections.abc import Callable
from pathlib import Path

from docs.follow import ROOT, follow, run_python
from matplotlib.figure import Figure
from PIL import Image

COLOURS = (128, 96, 64, 48)
"""Of a picture: as many as its maps need to show no steps, or fewer where that is
too much for a page."""

LARGEST = 60_000
"""Bytes, above which fewer colours are tried."""

DPI = 135
"""A figure 4.6 inches wide is then 621 pixels wide."""


class Workshop:
    """A folder of runs; what is there is not made again.

    Attributes:
        folder: where.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()

    def tutorial(self, name: str) -> Path:
        """The folder of a tutorial that was followed word for word."""
        page = ROOT / "docs" / "tutorials" / f"{name}.md"
        return self._make(f"tutorials/{name}", lambda folder: follow(page, folder))

    def run(self, out: str, *words: str, module: str = "pinav") -> Path:
        """The file or folder `out` of a command, which is made with `--out`."""
        command = ["-m", module, *words, "--out", out]
        return self._make(out, lambda _: run_python(command, self.folder))

    def file(self, name: str, write: Callable[[Path], None]) -> Path:
        """A file that is written by a function."""
        return self._make(name, write)

    def once(self, result: Path, *words: str) -> None:
        """A command that adds the file `result` to a run."""
        if not result.exists():
            run_python(["-m", "pinav", *words], self.folder)

    def _make(self, name: str, make: Callable[[Path], None]) -> Path:
        """Make a file or folder unless that was done; what was cut short goes."""
        path, mark = self.folder / name, self.folder / f"{name}.made"
        if not mark.exists():
            shutil.rmtree(path, ignore_errors=True)
            path.parent.mkdir(parents=True, exist_ok=True)
            make(path)
            mark.touch()
        return path


def save_picture(drawn: Figure | Path, path: Path) -> None:
    """Write a figure, or the picture of a run, as a small PNG of few colours."""
    source: io.BytesIO | Path
    if isinstance(drawn, Figure):
        source = io.BytesIO()
        drawn.savefig(source, dpi=DPI)
    else:
        source = drawn
    with Image.open(source) as opened:
        flat = Image.new("RGB", opened.size, (255, 255, 255))
        flat.paste(opened, mask=opened.getchannel("A") if "A" in opened.mode else None)
    # Of the methods tried, this one errs least for its bytes where maps are hatched.
    for colours in COLOURS:
        small = flat.quantize(
            colours,
            method=Image.Quantize.MAXCOVERAGE,
            kmeans=8,
            dither=Image.Dither.NONE,
        )
        small.save(path, optimize=True)
        if path.stat().st_size < LARGEST:
            break
