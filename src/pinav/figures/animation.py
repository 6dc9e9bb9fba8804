"""An animation of closed-loop runs, as one GIF file."""

import dataclasses
import itertools
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from pinav.figures.navigation import controller_keys, paths_map
from pinav.figures.palette import BLACK
from pinav.figures.style import (
    DIMENSIONLESS,
    SMALL,
    draw_panels,
    share_legend,
    style_of,
)
from pinav.files import atomic_write
from pinav.learning.findings import ForceMaps
from pinav.navigation.task.task import Course

FRAMES, DOTS = 60, 90
"""Frames of an animation at most, and dots per inch."""

FRAME_TIME, LAST_FRAME = 80, 1500
"""How long a frame is shown, and how long the last one [ms]."""


@dataclasses.dataclass(frozen=True)
class Trails:
    """Paths of controllers that move together.

    Attributes:
        paths: positions of one run of each controller until it ended [L].
        step: time between two of them [T].
    """

    paths: Mapping[str, Float[np.ndarray, "_ 2"]]
    step: float

    @property
    def steps(self) -> int:
        """Steps until nothing moves any more."""
        moving = [
            np.flatnonzero(np.any(np.diff(path, axis=0) != 0, axis=1))
            for path in self.paths.values()
        ]
        return max((int(steps[-1]) + 1 for steps in moving if steps.size), default=0)


def save_animation(
    course: Course,
    maps: ForceMaps,
    trails: Trails,
    path: Path,
    *,
    units: Mapping[str, str] = DIMENSIONLESS,
) -> Path:
    """Write runs over the true and the learned force as a GIF that repeats.

    The file appears whole or not at all, its folder is made; the same runs give the
    same bytes.
    """
    figure, axes = _stage(course, maps, trails, units)
    canvas = FigureCanvasAgg(figure)
    figure.set_dpi(DOTS)
    canvas.draw()
    figure.set_layout_engine("none")
    still = canvas.copy_from_bbox(figure.bbox)  # what no frame changes is drawn once
    moving = [_actors(ax, trails) for ax in axes]
    clock = figure.text(0.99, 0.99, "", fontsize=SMALL, ha="right", va="top")
    time = units.get("t", "1")
    unit = "" if time in ("1", "?") else f" {time}"
    frames = []
    count = min(FRAMES, trails.steps + 1)
    for step in np.unique(np.linspace(0, trails.steps, count).round().astype(int)):
        canvas.restore_region(still)
        clock.set_text(f"t = {step * trails.step:.2f}{unit}")
        figure.draw_artist(clock)
        for ax, actors in zip(axes, moving, strict=True):
            _move(actors, trails, int(step))
            for artist in itertools.chain(*actors.values()):
                ax.draw_artist(artist)
        image = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
        frames.append(image.quantize(64, method=Image.Quantize.FASTOCTREE))
    path.parent.mkdir(parents=True, exist_ok=True)
    times = [FRAME_TIME] * (len(frames) - 1) + [LAST_FRAME]
    options = {"save_all": True, "append_images": frames[1:], "loop": 0}
    atomic_write(
        path,
        lambda file: frames[0].save(
            file, format="GIF", duration=times, optimize=False, **options
        ),
        overwrite=True,
    )
    return path


def _stage(
    course: Course, maps: ForceMaps, trails: Trails, units: Mapping[str, str]
) -> tuple[Figure, list[Axes]]:
    """The maps on which the runs are shown."""
    both = {"true force": maps.truth, "learned force": maps.learned}
    fields = {name: field for name, field in both.items() if field is not None}
    forces = [np.linalg.norm(field.force, axis=-1) for field in fields.values()]
    limit = max(float(np.max(forces)), 1e-12)
    panels = {
        name: partial(paths_map, field, course, {}, limit=limit, units=units)
        for name, field in fields.items()
    }
    figure = draw_panels((3.2 * len(fields), 4.0), panels)
    share_legend(figure, controller_keys(trails.paths), columns=len(trails.paths))
    return figure, figure.axes[: len(fields)]


def _actors(ax: Axes, trails: Trails) -> dict:
    """A line and a dot for each controller; the oracle below and wide."""
    actors = {}
    for name in sorted(trails.paths, key=lambda name: name != "oracle"):
        color, below = style_of(name).color, name == "oracle"
        line = ax.plot([], [], color=color, lw=3.0 if below else 1.3)[0]
        size = 8 if below else 5
        dot = ax.plot([], [], "o", mfc=color, mec=BLACK, ms=size)[0]
        actors[name] = (line, dot)
    return actors


def _move(actors: dict, trails: Trails, step: int) -> None:
    for name, (line, dot) in actors.items():
        observed = trails.paths[name][: step + 1]
        line.set_data(*observed.T)
        dot.set_data(*observed[-1:].T)
