"""The findings of `pinav navigate --learn-online`, on a terminal and in a report."""

import math
from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from pinav.figures.animation import Trails, save_animation
from pinav.figures.fits import bands_figure, moments_figure
from pinav.figures.images import Movie, Picture
from pinav.figures.navigation import greatest_force, outcome_bars, paths_map
from pinav.figures.style import DIMENSIONLESS, draw_panels, with_unit
from pinav.navigation import FlightOutcome, Interval, OnlineNavigation
from pinav.report import Cell, Paragraph, Section, Table, quantity

DRAWN = 8
"""Flights of each controller on a map."""

FIRST = "visit 1"
"""The controller whose first flight is shown."""

CAPTION = (
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
        lambda: moments_figure(
            result.course,
            shown,
            result.paths[FIRST][0],
            step=result.step,
            thrust=result.thrust,
            units=result.units,
        ),
        "The first flight over its belief at several moments. Top: the mean force; "
        "bottom: its standard deviation. Where nothing was seen the mean is zero.",
    )
    bands = Picture(
        "learn-online-bands",
        lambda: bands_figure(shown, step=result.step, units=result.units),
        "The force along the first flight, as it was (line) and as it is believed at "
        "the end (mean and band of 95 %).",
        width=0.8,
    )
    words = map(Paragraph, online_sentences(result))
    table = online_table(rows, result.units)
    return [
        Section("Outcome", [*words, table, bars]),
        Section("Belief", [belief, bands]),
        Section("Flights", [_paths(result)]),
        Section("A flight", [_animation(result)]),
    ]


def online_table(
    controllers: Mapping[str, FlightOutcome], units: Mapping[str, str] = DIMENSIONLESS
) -> Table:
    """One row for each controller.

    Args:
        controllers: outcomes by their names.
        units: unit of each channel; "1" means dimensionless.
    """
    length, time = units.get("x", "1"), units.get("t", "1")
    columns: dict[str, Callable[[FlightOutcome], Cell]] = {
        "success": lambda row: percent_interval(row.success),
        "in time": lambda row: percent_interval(row.in_time),
        "violation": lambda row: percent_interval(row.violation),
        with_unit("arrival", time): lambda row: row.arrival.median,
        "5 %": lambda row: row.arrival.low,
        "95 %": lambda row: row.arrival.high,
        "regret": lambda row: "–" if row.regret is None else ratio_interval(row.regret),
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
    return Table(("flights", *columns), rows, f"{runs} flights each. {CAPTION}")


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


def _paths(result: OnlineNavigation) -> Picture:
    maps = result.shown.maps
    drawn = {name: paths[:DRAWN] for name, paths in result.paths.items()}
    shown = {"limit": greatest_force(maps), "units": result.units}
    panel = partial(paths_map, maps.truth, result.course, drawn, **shown)
    draw = partial(draw_panels, (4.6, 4.6), [panel])
    caption = f"At most {DRAWN} flights of each controller over the true force."
    return Picture("learn-online-paths", draw, caption, width=0.6)


def _animation(result: OnlineNavigation) -> Movie:
    paths = {name: some[0] for name, some in result.paths.items()}
    longest = max(len(path) for path in paths.values())
    still = {
        name: np.concatenate([path, np.tile(path[-1], (longest - len(path), 1))])
        for name, path in paths.items()
    }
    course, maps, trails = result.course, result.shown.maps, Trails(still, result.step)
    return Movie(
        "learn-online-flight",
        lambda file: save_animation(course, maps, trails, file, units=result.units),
        "One flight of each controller with the same noise.",
    )


def percent_interval(interval: Interval) -> str:
    """The interval of a proportion."""
    parts = interval.value, interval.lower, interval.upper
    value, lower, upper = (100 * part for part in parts)
    return f"{value:.0f} % ({lower:.0f}–{upper:.0f})"


def ratio_interval(interval: Interval) -> str:
    """The interval of a ratio."""
    parts = interval.value, interval.lower, interval.upper
    value, lower, upper = ("∞" if math.isinf(p) else f"{p:.3f}" for p in parts)
    return f"{value} ({lower}–{upper})"
