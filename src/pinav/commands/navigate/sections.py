"""The findings of `pinav navigate`: the same blocks on a terminal and in a report."""

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
from jaxtyping import Float

from pinav.commands.navigate.online_sections import (
    online_sections,
    percent_interval,
    ratio_interval,
)
from pinav.commands.steering import programme_table
from pinav.figures.animation import Trails, save_animation
from pinav.figures.images import Movie, Picture
from pinav.figures.navigation import (
    closed_loop_figure,
    outcome_bars,
    plan_map,
    space_figure,
)
from pinav.figures.style import draw_panels
from pinav.learning.findings import ForceMaps
from pinav.navigation import (
    AbstractNavigation,
    Interval,
    Navigation,
    OnlineNavigation,
    Suggestion,
    Summary,
)
from pinav.report import AbstractBlock, Cell, Paragraph, Section, Table, quantity
from pinav.units import force_unit

DRAWN = 8
"""Runs of each controller on a map."""

CAPTION = (
    "Success and violation with Wilson's 95 % interval; arrival: median time of those "
    "that arrived; regret: median over paired runs of the arrival time over that with "
    "the truth; efficiency: straight distance over length of the path."
)


def sections(result: AbstractNavigation) -> list[Section]:
    """The outcome, and what led there."""
    if isinstance(result, OnlineNavigation):
        return online_sections(result)
    assert isinstance(result, Navigation)
    successes = {name: row.success for name, row in result.controllers.items()}
    bars = Picture(
        "navigate-outcome",
        lambda: outcome_bars(successes, result.regret),
        "Success and regret, with 95 % intervals.",
    )
    table = controller_table(result.controllers, result.regret)
    words = map(Paragraph, sentences(result))
    outcome: list[AbstractBlock] = [*words, table, bars]
    parts = [Section("Outcome", outcome)]
    if result.maps is None:
        return [*parts, Section("Closed loop", [_in_space(result)])]
    if result.suggestion is not None:
        outcome.append(_programme(result.suggestion, result.units.get("t", "1")))
    return [
        *parts,
        Section("Plan", [_plan(result)]),
        Section("Closed loop", [_loops(result, result.maps)]),
        Section("A run", [_animation(result, result.maps)]),
    ]


def controller_table(
    controllers: Mapping[str, Summary], regret: Mapping[str, Interval]
) -> Table:
    """One row for each controller."""

    def ratio(name: str) -> str:
        return ratio_interval(regret[name]) if name in regret else "–"

    columns: dict[str, Callable[[tuple[str, Summary]], Cell]] = {
        "controller": lambda one: one[0],
        "success": lambda one: percent_interval(one[1].success),
        "violation": lambda one: percent_interval(one[1].violation),
        "arrival": lambda one: one[1].arrival.median,
        "regret": lambda one: ratio(one[0]),
        "efficiency": lambda one: one[1].efficiency,
        "least clearance": lambda one: one[1].clearance,
    }
    runs = next(iter(controllers.values())).runs
    return Table.of(controllers.items(), columns, f"{runs} runs each. {CAPTION}")


def sentences(result: Navigation) -> list[str]:
    """The findings in words."""
    plan, computing, time = result.plan, result.computing, result.units.get("t", "")
    reach = (
        f"from {100 * plan.unreachable:.2g} % of the arena the goal cannot be reached"
        if plan.unreachable
        else "from everywhere in the arena the goal can be reached"
    )
    lines = [
        f"The plan takes {quantity(plan.time, time)} from rest; {reach} in time.",
        f"Tried in {environment_words(result)}.",
        f"A control step takes {1e3 * computing.median:.2g} ms, the first one "
        f"{computing.first:.2g} s with its compilation.",
    ]
    if result.delay:
        lines.append(f"Commands act after {quantity(result.delay, time)}.")
    for name, reason in result.refused.items():
        lines.append(f"No run with the model {name}: {reason}.")
    if result.suggestion is not None:
        lines.append(_advice(result.suggestion, force_unit(result.units)))
    return lines


def environment_words(result: Navigation) -> str:
    """The environment of the closed loops, in words."""
    if result.truth is None:
        return (
            "environments drawn from the posterior, or the model itself where there is "
            "none: the true one is not known"
        )
    return f"the true environment of {result.truth} (synthetic)"


def _advice(suggestion: Suggestion, unit: str) -> str:
    random = suggestion.sd_after_random
    other = "" if random is None else f", a random one to {quantity(random, unit, 2)}"
    return (
        "The next trajectory to record (suggestion.csv) should lower the standard "
        "deviation of the learned field along the route from "
        f"{quantity(suggestion.sd, unit, 2)} to "
        f"{quantity(suggestion.sd_after, unit, 2)}{other}."
    )


def _programme(suggestion: Suggestion, unit: str) -> Table:
    """The commands of the suggested trajectory."""
    x, y = suggestion.start
    caption = (
        f"Commands of the trajectory to record next, released at ({x:.4g}, {y:.4g}) "
        f"for {quantity(suggestion.times[-1], unit)}; linear between the times."
    )
    return programme_table(suggestion, caption, "suggestion")


def _plan(result: Navigation) -> Picture:
    shown = {"route": result.plan.route, "units": result.units}
    panel = partial(plan_map, result.plan.times, result.course, **shown)
    caption = (
        "Time to the goal (cross) from rest, as planned on the learned force with the "
        "greatest thrust, and the planned way from the start (circle). Hatched: the "
        "goal cannot be reached within the time limit."
    )
    draw = partial(draw_panels, (4.6, 5.0), [panel])
    return Picture("navigate-plan", draw, caption, width=0.6)


def _paths(result: Navigation) -> dict[str, list[Float[np.ndarray, "_ dim"]]]:
    """Positions of a few runs of each controller [L]."""
    dim = len(result.course.start)
    return {
        name: [
            states[: steps + 1, :dim]
            for states, steps in zip(
                loops.states[:DRAWN], loops.steps[:DRAWN].tolist(), strict=True
            )
        ]
        for name, loops in result.episodes.items()
    }


def _in_space(result: Navigation) -> Picture:
    caption = (
        f"Paths of at most {DRAWN} runs of each controller, in "
        f"{environment_words(result)}, from start (circle) to goal (cross), and "
        "the way planned on the learned force (dashed). The controllers differ in the "
        "model with which they plan. Balls must not be entered."
    )
    shown = {"route": result.plan.route, "units": result.units}
    draw = partial(space_figure, result.course, _paths(result), **shown)
    return Picture("navigate-closed-loop", draw, caption)


def _loops(result: Navigation, maps: ForceMaps) -> Picture:
    draw = partial(
        closed_loop_figure,
        result.course,
        maps,
        _paths(result),
        thrust=result.thrust,
        route=result.plan.route,
        suggestion=None if result.suggestion is None else result.suggestion.path,
        units=result.units,
    )
    caption = (
        f"Paths of at most {DRAWN} runs of each controller, in "
        f"{environment_words(result)}. The controllers differ in the model with which "
        "they plan."
    )
    return Picture("navigate-closed-loop", draw, caption)


def _animation(result: Navigation, maps: ForceMaps) -> Movie:
    paths = {name: loops.states[0, :, :2] for name, loops in result.episodes.items()}
    shown = result.course, maps, Trails(paths, result.step)
    return Movie(
        "navigate-run",
        lambda file: save_animation(*shown, file, units=result.units),
        "One run of each controller with the same noise.",
    )
