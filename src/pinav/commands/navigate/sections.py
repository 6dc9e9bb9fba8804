"""The findings of `pinav navigate`: the same blocks on a terminal and in a report."""

import math
from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
from jaxtyping import Float

from pinav.commands.steering import programme_table
from pinav.figures.animation import Trails, save_animation
from pinav.figures.fits import bands_figure, moments_figure
from pinav.figures.images import Movie, Picture
from pinav.figures.navigation import (
    closed_loop_figure,
    greatest_force,
    outcome_bars,
    paths_map,
    plan_map,
    space_figure,
)
from pinav.figures.style import DIMENSIONLESS, draw_panels, with_unit
from pinav.learning.findings import ForceMaps
from pinav.navigation import (
    AbstractNavigation,
    FlightOutcome,
    Interval,
    Navigation,
    OnlineNavigation,
    Suggestion,
    Summary,
)
from pinav.report import AbstractBlock, Cell, Paragraph, Section, Table, quantity
from pinav.units import force_unit

DRAWN = 8
"""Runs or flights of each controller on a map."""

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
    first = {name: one.states[0, :, :2] for name, one in result.episodes.items()}
    return [
        *parts,
        Section("Plan", [_plan(result)]),
        Section("Closed loop", [_loops(result)]),
        Section("A run", [_movie("navigate-run", "run", result, result.maps, first)]),
    ]


def controller_table(
    controllers: Mapping[str, Summary], regret: Mapping[str, Interval]
) -> Table:
    """One row for each controller."""
    columns: dict[str, Callable[[tuple[str, Summary]], Cell]] = {
        "controller": lambda one: one[0],
        "success": lambda one: percent_interval(one[1].success),
        "violation": lambda one: percent_interval(one[1].violation),
        "arrival": lambda one: one[1].arrival.median,
        "regret": lambda one: ratio_interval(regret.get(one[0])),
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
    draw = partial(space_figure, result, _paths(result))
    return Picture("navigate-closed-loop", draw, caption)


def _loops(result: Navigation) -> Picture:
    draw = partial(closed_loop_figure, result, _paths(result))
    caption = (
        f"Paths of at most {DRAWN} runs of each controller, in "
        f"{environment_words(result)}. The controllers differ in the model with which "
        "they plan."
    )
    return Picture("navigate-closed-loop", draw, caption)


def _movie(
    name: str,
    what: str,
    result: Navigation | OnlineNavigation,
    maps: ForceMaps,
    paths: Mapping[str, Float[np.ndarray, "_ 2"]],
) -> Movie:
    """One run or flight of each controller over the force."""
    trails, units = Trails(paths, result.step), result.units
    write = partial(save_animation, result.course, maps, trails, units=units)
    return Movie(name, write, f"One {what} of each controller with the same noise.")


ONLINE_CAPTION = (
    "Success, violation and arrival within the task's own limit (in time) with "
    "Wilson's 95 % interval; arrival: median and quantiles of those that arrived; "
    "regret: median over pairs of the arrival time over that with the true force; "
    "force error: root sum of squared errors over the visited path, relative; cover: "
    "of nominal 95 % bands there; consistency: squared error of the position over its "
    "variance, 1 where the filter is right."
)


def online_sections(result: OnlineNavigation) -> list[Section]:
    """The outcome, what was believed, and the flights."""
    rows, shown = result.controllers, result.shown
    successes = {name: row.success for name, row in rows.items()}
    regrets = {n: row.regret for n, row in rows.items() if row.regret is not None}
    bars = Picture(
        "learn-online-regret",
        lambda: outcome_bars(successes, regrets),
        "Success and regret with 95 % intervals.",
        width=0.7,
    )
    belief = Picture(
        "learn-online-belief",
        partial(moments_figure, result),
        "The first flight over its belief at several moments. Top: the mean force; "
        "bottom: its standard deviation. Where nothing was seen the mean is zero.",
    )
    bands = Picture(
        "learn-online-bands",
        partial(bands_figure, result),
        "The force along the first flight, as it was (line) and as it is believed at "
        "the end (mean and band of 95 %).",
        width=0.8,
    )
    words = map(Paragraph, online_sentences(result))
    table = online_table(rows, result.units)
    first = {name: paths[0] for name, paths in result.paths.items()}
    movie = _movie("learn-online-flight", "flight", result, shown.maps, first)
    return [
        Section("Outcome", [*words, table, bars]),
        Section("Belief", [belief, bands]),
        Section("Flights", [_flights(result)]),
        Section("A flight", [movie]),
    ]


def online_table(
    controllers: Mapping[str, FlightOutcome], units: Mapping[str, str] = DIMENSIONLESS
) -> Table:
    """One row for each controller."""
    length, time = units.get("x", "1"), units.get("t", "1")
    columns: dict[str, Callable[[FlightOutcome], Cell]] = {
        "success": lambda row: percent_interval(row.success),
        "in time": lambda row: percent_interval(row.in_time),
        "violation": lambda row: percent_interval(row.violation),
        with_unit("arrival", time): lambda row: row.arrival.median,
        "5 %": lambda row: row.arrival.low,
        "95 %": lambda row: row.arrival.high,
        "regret": lambda row: ratio_interval(row.regret),
        with_unit("least clearance", length): lambda row: row.clearance,
        "force error": lambda row: row.force_error,
        "cover": lambda row: row.cover,
        "consistency": lambda row: row.consistency,
    }
    rows = [
        (name, *(column(row) for column in columns.values()))
        for name, row in controllers.items()
    ]
    runs = next(iter(controllers.values())).runs
    return Table(("flights", *columns), rows, f"{runs} flights each. {ONLINE_CAPTION}")


def online_sentences(result: OnlineNavigation) -> list[str]:
    """The findings in words."""
    last = list(result.controllers.values())[1]
    length, time = (result.units.get(channel, "1") for channel in ("x", "t"))
    before = "the fit alone" if result.prior else "nothing"
    frame, command, plan = (
        0.0 if np.isnan(seconds) else 1e3 * seconds
        for seconds in (last.frame_time, last.command_time, last.replan_time)
    )
    return [
        f"Task {result.task} (synthetic): {before} is known of the force beforehand; "
        f"positions with an error of {quantity(result.position_noise, length)} are all "
        "that is observed, commands come into force after "
        f"{quantity(result.delay, time)}.",
        f"Flights were given up after {quantity(result.time_limit, time)}; the "
        f"task's own limit is {quantity(result.own_limit, time)}.",
        f"Learning from a frame takes at most {frame:.2g} ms (99 %), a command "
        f"{command:.2g} ms, a plan {plan:.2g} ms (medians); the belief takes "
        f"{last.memory / 1e6:.2g} MB. The safety filter changed {last.changed:.2g} "
        "commands in a flight.",
    ]


def _flights(result: OnlineNavigation) -> Picture:
    maps = result.shown.maps
    drawn = {name: paths[:DRAWN] for name, paths in result.paths.items()}
    shown = {"limit": greatest_force(maps), "units": result.units}
    panel = partial(paths_map, maps.truth, result.course, drawn, **shown)
    draw = partial(draw_panels, (4.6, 4.6), [panel])
    caption = f"At most {DRAWN} flights of each controller over the true force."
    return Picture("learn-online-paths", draw, caption, width=0.6)


def percent_interval(interval: Interval) -> str:
    """The interval of a proportion."""
    parts = interval.value, interval.lower, interval.upper
    value, lower, upper = (100 * part for part in parts)
    return f"{value:.0f} % ({lower:.0f}–{upper:.0f})"


def ratio_interval(interval: Interval | None) -> str | None:
    """The interval of a ratio, if there is one."""
    if interval is None:
        return None
    parts = interval.value, interval.lower, interval.upper
    value, lower, upper = ("∞" if math.isinf(p) else f"{p:.3f}" for p in parts)
    return f"{value} ({lower}–{upper})"
