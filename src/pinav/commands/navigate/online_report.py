"""Figures and sections of `pinav navigate --learn-online`."""

from collections.abc import Mapping

import numpy as np

from pinav.commands.navigate.online import OnlineMetrics
from pinav.commands.navigate.online_tables import online_table, sentences
from pinav.figures.animation import Trails, save_animation
from pinav.figures.images import Figures
from pinav.figures.learning import bands_figure, moments_figure
from pinav.figures.navigation import Course, field_of, outcome_bars, paths_map
from pinav.figures.style import new_figure
from pinav.report import Image, Paragraph, Section
from pinav.runs import RunFolder

DRAWN = 8
"""Flights of each controller on a map."""


def learns_online(folder: RunFolder) -> bool:
    """Whether a run was made with `--learn-online`."""
    return "strategy" in folder.read_json("metrics.json")


def online_sections(folder: RunFolder) -> list[Section]:
    """The sections of a finished run."""
    metrics = folder.read_metrics("metrics.json", OnlineMetrics)
    arrays, figures = folder.read_arrays("results.npz"), Figures(folder.path)
    rows = metrics.controllers
    bars = outcome_bars(
        {name: row.success for name, row in rows.items()},
        {name: row.regret for name, row in rows.items() if row.regret is not None},
    )
    regrets = figures.image(
        "learn-online-regret",
        bars,
        "Success and regret with 95 % intervals.",
        width=0.7,
    )
    words = [Paragraph(line) for line in sentences(metrics)]
    belief = figures.image(
        "learn-online-belief",
        moments_figure(arrays, thrust=metrics.thrust, units=metrics.units),
        "The first flight over its belief at several moments. Top: the mean force; "
        "bottom: its standard deviation. Where nothing was seen the mean is zero.",
    )
    bands = figures.image(
        "learn-online-bands",
        bands_figure(arrays, units=metrics.units),
        "The force along the first flight, as it was (line) and as it is believed at "
        "the end (mean and band of 95 %).",
        width=0.8,
    )
    return [
        Section("Outcome", [*words, online_table(rows, metrics.units), regrets]),
        Section("Belief", [belief, bands]),
        Section("Flights", [_paths(figures, arrays, metrics)]),
        Section("A flight", [_animation(figures, arrays, metrics)]),
    ]


def _paths(
    figures: Figures, arrays: Mapping[str, np.ndarray], metrics: OnlineMetrics
) -> Image:
    paths = {
        name: [arrays[f"path/{name}/{k}"] for k in range(min(row.runs, DRAWN))]
        for name, row in metrics.controllers.items()
    }
    figure = new_figure(4.6, 4.6)
    ax = figure.add_subplot()
    limit = max(float(np.linalg.norm(arrays["field/true"], axis=-1).max()), 1e-12)
    field = field_of(arrays, "field/true")
    paths_map(field, Course(arrays), paths, limit=limit, units=metrics.units, ax=ax)
    caption = f"At most {DRAWN} flights of each controller over the true force."
    return figures.image("learn-online-paths", figure, caption, width=0.6)


def _animation(
    figures: Figures, arrays: Mapping[str, np.ndarray], metrics: OnlineMetrics
) -> Image:
    paths = {name: arrays[f"path/{name}/0"] for name in metrics.controllers}
    longest = max(len(path) for path in paths.values())
    still = {
        name: np.concatenate([path, np.tile(path[-1], (longest - len(path), 1))])
        for name, path in paths.items()
    }
    file = figures.folder / "learn-online-flight.gif"
    trails = Trails(still, float(arrays["step"]))
    save_animation(arrays, trails, file, units=metrics.units)
    caption = "One flight of each controller with the same noise."
    return Image(file, caption, caption)
