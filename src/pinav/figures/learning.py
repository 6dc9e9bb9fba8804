"""Figures of a force that is learned on the way."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from pinav.evaluation import FieldMap, normal_interval
from pinav.figures.bands import band
from pinav.figures.navigation import Course, paths_map, spread_map
from pinav.figures.style import (
    DIMENSIONLESS,
    channel_label,
    label_axes,
    new_figure,
    title_panel,
    with_unit,
)
from pinav.units import force_unit

Arrays = Mapping[str, np.ndarray]


def moments_figure(
    arrays: Arrays, *, thrust: float, units: Mapping[str, str] = DIMENSIONLESS
) -> Figure:
    """Path so far over mean and standard deviation of the force, at some moments.

    Args:
        arrays: results of a run that learned on the way.
        thrust: greatest thrust of the swimmer [L T⁻²].
        units: unit of each channel; "1" means dimensionless.
    """
    times, step = arrays["moments/time"], float(arrays["step"])
    course, path = Course(arrays), arrays["path/visit 1/0"]
    limit = max(float(np.linalg.norm(arrays["field/true"], axis=-1).max()), 1e-12)
    figure = new_figure(2.3 * len(times), 5.2)
    axes = figure.subplots(2, len(times), squeeze=False)
    for k, now in enumerate(times):
        so_far = path[: round(float(now) / step) + 1]
        mean, sd = arrays["moments/mean"][k], arrays["moments/sd"][k]
        nothing = np.zeros(mean.shape[:2])
        field = FieldMap(arrays["field/x"], arrays["field/y"], mean, nothing)
        shown = {"visit 1": [so_far]}
        top, low = axes[:, k]
        paths_map(field, course, shown, limit=limit, units=units, ax=top)
        ground = {"thrust": thrust, "route": so_far, "units": units}
        spread_map(field, sd, course, **ground, ax=low)
        unit = units.get("t", "1")
        title_panel(top, f"t = {float(now):.3g}{'' if unit == '1' else f' {unit}'}")
    return figure


def bands_figure(arrays: Arrays, *, units: Mapping[str, str] = DIMENSIONLESS) -> Figure:
    """Both components of the force along a path, with their bands of 95 %.

    Args:
        arrays: results of a run that learned on the way.
        units: unit of each channel; "1" means dimensionless.
    """
    truth, mean, sd = (arrays[f"band/{name}"] for name in ("true", "mean", "sd"))
    t = float(arrays["step"]) * np.arange(len(truth))
    figure = new_figure(6.4, 3.6)
    for k, ax in enumerate(figure.subplots(2, 1, sharex=True)):
        ends = normal_interval(mean[:, k], sd[:, k])
        band(t, mean[:, k], ends, truth=truth[:, k], ax=ax)
        force = with_unit(f"$F_{'xy'[k]}$", force_unit(units))
        label_axes(ax, channel_label("t", units) if k else "", force)
    return figure
