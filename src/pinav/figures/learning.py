"""Figures of a force that is learned on the way."""

import dataclasses
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from pinav.evaluation import normal_interval
from pinav.figures.bands import band
from pinav.figures.navigation import greatest_force, paths_map, spread_map
from pinav.figures.style import (
    DIMENSIONLESS,
    channel_label,
    label_axes,
    new_figure,
    title_panel,
    with_unit,
)
from pinav.navigation.adaptive.swimmer import ShownFlight
from pinav.navigation.maps import Course
from pinav.units import force_unit


def moments_figure(
    course: Course,
    shown: ShownFlight,
    path: Float[np.ndarray, "frame 2"],
    *,
    step: float,
    thrust: float,
    units: Mapping[str, str] = DIMENSIONLESS,
) -> Figure:
    """Path so far over mean and standard deviation of the force, at some moments.

    Args:
        course: start, goal and obstacles.
        shown: what the flight has learned.
        path: its positions [L].
        step: time between two of them [T].
        thrust: greatest thrust of the swimmer [L T⁻²].
        units: unit of each channel; "1" means dimensionless.
    """
    maps, limit = shown.maps, greatest_force(shown.maps)
    figure = new_figure(2.3 * len(shown.times), 5.2)
    axes = figure.subplots(2, len(shown.times), squeeze=False)
    moments = zip(axes.T, shown.times.tolist(), shown.means, shown.sds, strict=True)
    for (top, low), now, mean, sd in moments:
        so_far = path[: round(now / step) + 1]
        field = dataclasses.replace(maps.learned, force=mean)
        drawn = {"visit 1": [so_far]}
        paths_map(field, course, drawn, limit=limit, units=units, ax=top)
        ground = {"thrust": thrust, "route": so_far, "units": units}
        spread_map(field, sd, course, **ground, ax=low)
        unit = units.get("t", "1")
        title_panel(top, f"t = {now:.3g}{'' if unit == '1' else f' {unit}'}")
    return figure


def bands_figure(
    shown: ShownFlight, *, step: float, units: Mapping[str, str] = DIMENSIONLESS
) -> Figure:
    """Both components of the force along a path, with their bands of 95 %.

    Args:
        shown: what the flight has learned.
        step: time between two positions of the path [T].
        units: unit of each channel; "1" means dimensionless.
    """
    truth, mean, sd = shown.truth, shown.mean, shown.sd
    t = step * np.arange(len(truth))
    figure = new_figure(6.4, 3.6)
    for k, ax in enumerate(figure.subplots(2, 1, sharex=True)):
        ends = normal_interval(mean[:, k], sd[:, k])
        band(t, mean[:, k], ends, truth=truth[:, k], ax=ax)
        force = with_unit(f"$F_{'xy'[k]}$", force_unit(units))
        label_axes(ax, channel_label("t", units) if k else "", force)
    return figure
