"""Figures and sections of `pinav navigate`."""

from collections.abc import Mapping

import numpy as np

from pinav.commands.navigate.metrics import NavigationMetrics
from pinav.commands.navigate.online_report import learns_online, online_sections
from pinav.commands.navigate.tables import (
    controller_table,
    environment_words,
    sentences,
)
from pinav.figures.animation import Trails, save_animation
from pinav.figures.images import Figures
from pinav.figures.navigation import Course, closed_loop_figure, outcome_bars, plan_map
from pinav.figures.space import space_figure
from pinav.figures.style import new_figure
from pinav.report import Image, Paragraph, Section
from pinav.runs import RunFolder
from pinav.units import with_order

DRAWN = 8
"""Runs of each controller on a map."""

Arrays = Mapping[str, np.ndarray]


def navigation_sections(folder: RunFolder) -> list[Section]:
    """The sections of a finished run."""
    if learns_online(folder):
        return online_sections(folder)
    metrics = folder.read_metrics("metrics.json", NavigationMetrics)
    arrays, figures = folder.read_arrays("results.npz"), Figures(folder.path)
    words = [Paragraph(line) for line in sentences(metrics)]
    bars = outcome_bars(
        {name: row.success for name, row in metrics.controllers.items()}, metrics.regret
    )
    caption = "Success and regret, with 95 % intervals."
    outcome = [
        *words,
        controller_table(metrics.controllers, metrics.regret),
        figures.image("navigate-outcome", bars, caption),
    ]
    if len(arrays["start"]) > 2:
        loops = _in_space(figures, arrays, metrics)
        return [Section("Outcome", outcome), Section("Closed loop", [loops])]
    return [
        Section("Outcome", outcome),
        Section("Plan", [_plan(figures, arrays, metrics)]),
        Section("Closed loop", [_loops(figures, arrays, metrics)]),
        Section("A run", [_animation(figures, arrays, metrics)]),
    ]


def _units(metrics: NavigationMetrics) -> Mapping[str, str]:
    return with_order(metrics.units, metrics.order, metrics.force)


def _plan(figures: Figures, arrays: Arrays, metrics: NavigationMetrics) -> Image:
    figure = new_figure(4.6, 5.0)
    axes = figure.add_subplot()
    units = _units(metrics)
    course, route = Course(arrays), arrays["route"]
    plan_map(arrays["plan/time"], course, route=route, units=units, ax=axes)
    caption = (
        "Time to the goal (cross) from rest, as planned on the learned force with the "
        "greatest thrust, and the planned way from the start (circle). Hatched: the "
        "goal cannot be reached within the time limit."
    )
    return figures.image("navigate-plan", figure, caption, width=0.6)


def _paths(arrays: Arrays, metrics: NavigationMetrics) -> dict[str, list[np.ndarray]]:
    """Positions of a few runs of each controller [L]."""
    dim = len(arrays["start"])
    return {
        name: [
            states[: steps + 1, :dim]
            for states, steps in zip(
                arrays[f"states/{name}"][:DRAWN],
                arrays[f"steps/{name}"][:DRAWN],
                strict=True,
            )
        ]
        for name in metrics.controllers
    }


def _in_space(figures: Figures, arrays: Arrays, metrics: NavigationMetrics) -> Image:
    figure = space_figure(arrays, _paths(arrays, metrics), units=_units(metrics))
    caption = (
        f"Paths of at most {DRAWN} runs of each controller, in "
        f"{environment_words(metrics)}, from start (circle) to goal (cross), and "
        "the way planned on the learned force (dashed). The controllers differ in the "
        "model with which they plan. Balls must not be entered."
    )
    return figures.image("navigate-closed-loop", figure, caption)


def _loops(figures: Figures, arrays: Arrays, metrics: NavigationMetrics) -> Image:
    figure = closed_loop_figure(
        arrays,
        _paths(arrays, metrics),
        thrust=metrics.thrust,
        units=_units(metrics),
    )
    caption = (
        f"Paths of at most {DRAWN} runs of each controller, in "
        f"{environment_words(metrics)}. The controllers differ in the model with which "
        "they plan."
    )
    return figures.image("navigate-closed-loop", figure, caption)


def _animation(figures: Figures, arrays: Arrays, metrics: NavigationMetrics) -> Image:
    paths = {n: arrays[f"states/{n}"][0, :, :2] for n in metrics.controllers}
    trails = Trails(paths, float(arrays["step"]))
    file = figures.folder / "navigate-run.gif"
    save_animation(arrays, trails, file, units=_units(metrics))
    caption = "One run of each controller with the same noise."
    return Image(file, caption, caption)
