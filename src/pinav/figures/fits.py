"""Figures of a fit: its paths, its force, the profiles of terms, learning."""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pinav.evaluation import ForceLine, normal_interval
from pinav.figures.images import Picture
from pinav.figures.maps import force_comparison
from pinav.figures.navigation import greatest_force, paths_map, spread_map
from pinav.figures.palette import GREEN, GREY, LEARNED, PURPLE, TRUTH
from pinav.figures.recordings import observed_paths, positions_over_time
from pinav.figures.style import (
    add_legend,
    band,
    channel_label,
    draw_panels,
    label_axes,
    new_figure,
    title_panel,
    with_unit,
)
from pinav.figures.trajectories import loss_curve
from pinav.learning.findings import Findings, FoundTerm, Rollouts
from pinav.navigation import OnlineNavigation
from pinav.trajectories import POSITION_CHANNELS
from pinav.units import force_unit

STRAIGHT = ("wall", "shear layer")
"""Terms whose coordinate is no distance."""


def fit_figure(fit: Findings) -> Picture:
    """All trajectories with rollouts, and the loss where the recipe has one."""
    rollouts, losses, units = fit.rollouts, fit.losses, fit.units
    observed, predicted = _observed(rollouts), _pieces(rollouts, rollouts.predicted)
    if sum(name in POSITION_CHANNELS for name in rollouts.channels) == 1:
        name = rollouts.channels[0]
        paths = partial(
            positions_over_time,
            _pieces(rollouts, rollouts.times),
            [one[:, 0] for one in observed],
            [one[:, 0] for one in predicted],
            labels=(
                with_unit("time", units.get("t", "1")),
                with_unit(name, units.get(name, "1")),
            ),
        )
    else:
        paths = partial(
            observed_paths, observed, [ys[:, :2] for ys in predicted], units=units
        )

    def draw() -> Figure:
        figure = new_figure(4.2 if losses is None else 7.5, 3.4)
        axes = figure.subplots(1, 1 if losses is None else 2, squeeze=False)[0]
        paths(ax=axes[0])
        if losses is not None:
            loss_curve(losses.values, losses.phases, ax=axes[1])
        return figure

    caption = "Observed positions and rollouts of the fitted model."
    if losses is not None:
        caption += " Right: training loss."
    return Picture(
        "fit", draw, caption, "Observed trajectories and rollouts of the model"
    )


def _pieces(rollouts: Rollouts, values: np.ndarray) -> list[np.ndarray]:
    """The values of each trajectory without the padding."""
    return [one[:n] for one, n in zip(values, rollouts.lengths, strict=True)]


def _observed(rollouts: Rollouts) -> list[np.ndarray]:
    """The positions of each trajectory, NaN where there is none."""
    seen = np.where(rollouts.observed, rollouts.states, np.nan)
    return _pieces(rollouts, seen[..., :2])


def learned_force_figure(fit: Findings) -> Picture | None:
    """Maps of the force, its truth and its uncertainty; None without a plane."""
    maps = fit.force
    if maps is None:
        return None
    learned, gap = maps.learned, np.full((1, 2), np.nan)
    pieces = [part for seen in _observed(fit.rollouts) for part in (seen, gap)]
    shown = {"true": maps.truth, "sd": maps.sd, "units": fit.units}
    shown["path"] = np.concatenate(pieces)
    unit = fit.units.get("x", "1")
    return Picture(
        "force",
        partial(force_comparison, learned, **shown),
        "The force of the environment on a swimmer at rest. Hatched: unvisited, an "
        f"extrapolation ({learned.regions.definition(unit)}).",
        "Maps of the learned force and of how well it is known",
    )


def _small_picture(
    name: str, draw: Callable[..., Any], caption: str, alt: str
) -> Picture:
    """The picture of one band."""
    return Picture(name, partial(draw_panels, (4.2, 2.6), [draw]), caption, alt)


def force_line_figures(fit: Findings) -> list[Picture]:
    """The force along lines through data that are not planar."""
    pictures = []
    for name, line in (fit.lines or {}).items():
        units = fit.units.get(name, "1"), fit.units.get("force", "?")
        caption = f"The force along {name} through the middle of the data"
        caption += "." if line.true is None else "; dashed: the truth."
        draw = partial(_force_band, name, line, units)
        pictures.append(
            _small_picture(f"force-{name}", draw, caption, f"Force over {name}")
        )
    return pictures


def _force_band(
    coordinate: str, line: ForceLine, units: tuple[str, str], *, ax: Axes
) -> None:
    """A force along a coordinate with its band; units of length and of force."""
    labels = with_unit(coordinate, units[0]), with_unit("force", units[1])
    sd = np.zeros_like(line.force) if line.sd is None else line.sd
    interval = normal_interval(line.force, sd)
    band(line.places, line.force, interval, labels=labels, ax=ax)
    ax.axhline(0.0, color=GREY, lw=0.6)
    if line.true is not None:
        ax.plot(line.places, line.true, color=TRUTH, lw=1.0, ls="--")


def profile_figure(index: int, term: FoundTerm, fit: Findings) -> Picture | None:
    """The profile of a term with its band; None of a term that has none."""
    if term.profile is None:
        return None
    coordinate = "along the normal" if term.name in STRAIGHT else "distance"
    units = fit.units.get("x", "1"), force_unit(fit.units)
    return _small_picture(
        f"profile-{index}",
        partial(_force_band, coordinate, term.profile, units),
        f"The force of the term '{term.name}' with its band of 95 %.",
        f"Profile of the term {term.name}",
    )


def thermal_figures(fit: Findings) -> list[Picture]:
    """Diffusion along lines through the data, and the path of a reference."""
    thermal, (length, time) = fit.thermal, (fit.units.get(name, "1") for name in "xt")
    if thermal is None:
        return []
    pictures = [_diffusion_figure(fit, name) for name in thermal.lines]
    path = thermal.reference
    if path is None:
        return pictures
    labels = with_unit("time", time), with_unit("reference", length)
    interval = normal_interval(path.values, path.sd)
    draw = partial(band, path.times, path.values, interval, labels=labels)
    caption = "Path of the frame of reference, about its mean, with its 95 % band."
    return [
        *pictures,
        _small_picture("reference", draw, caption, "Path of the reference"),
    ]


def _diffusion_figure(fit: Findings, name: str) -> Picture:
    """Diffusion along each channel over one coordinate; equal ones are drawn once."""
    assert fit.thermal is not None
    line, channels = fit.thermal.lines[name], fit.thermal.channels
    length, time = fit.units.get(channels[0], "1"), fit.units.get("t", "1")
    is_known = "1" not in (length, time) and "?" not in length + time
    unit = f"{length}²/{time}" if is_known else ""
    labels = with_unit(name, length), with_unit("diffusion", unit)
    columns: dict[bytes, list[int]] = {}
    for index, column in enumerate(line.values.T):
        columns.setdefault(column.tobytes(), []).append(index)

    def draw(ax: Axes) -> None:
        colors = LEARNED, GREEN, PURPLE
        for color, group in zip(colors, columns.values(), strict=False):
            along = ", ".join(channels[index] for index in group)
            mean, sd = line.values[:, group[0]], line.sd[:, group[0]]
            shown = {"color": color, "name": f"along {along}", "labels": labels}
            band(line.places, mean, normal_interval(mean, sd), **shown, ax=ax)
        ax.set_ylim(bottom=0.0)
        if len(columns) > 1:
            add_legend(ax)

    caption = f"Diffusion along {name} through the middle of the data, 95 % bands."
    return _small_picture(f"diffusion-{name}", draw, caption, f"Diffusion over {name}")


FIRST = "visit 1"
"""The controller whose first flight is shown."""


def moments_figure(result: OnlineNavigation) -> Figure:
    """Path so far over mean and standard deviation of the force, at some moments."""
    shown, course, units = result.shown, result.course, result.units
    maps, path = shown.maps, result.paths[FIRST][0]
    drawing = {"limit": greatest_force(maps), "units": units}
    figure = new_figure(2.3 * len(shown.times), 5.2)
    axes = figure.subplots(2, len(shown.times), squeeze=False)
    moments = zip(axes.T, shown.times.tolist(), shown.means, shown.sds, strict=True)
    for (top, low), now, mean, sd in moments:
        so_far = path[: round(now / result.step) + 1]
        field = dataclasses.replace(maps.learned, force=mean)
        paths_map(field, course, {FIRST: [so_far]}, **drawing, ax=top)
        ground = {"thrust": result.thrust, "route": so_far, "units": units}
        spread_map(field, sd, course, **ground, ax=low)
        unit = units.get("t", "1")
        title_panel(top, f"t = {now:.3g}{'' if unit == '1' else f' {unit}'}")
    return figure


def bands_figure(result: OnlineNavigation) -> Figure:
    """Both components of the force along a path, with their bands of 95 %."""
    shown, units = result.shown, result.units
    truth, mean, sd = shown.truth, shown.mean, shown.sd
    t = result.step * np.arange(len(truth))
    figure = new_figure(6.4, 3.6)
    for k, ax in enumerate(figure.subplots(2, 1, sharex=True)):
        ends = normal_interval(mean[:, k], sd[:, k])
        band(t, mean[:, k], ends, truth=truth[:, k], ax=ax)
        force = with_unit(f"$F_{'xy'[k]}$", force_unit(units))
        label_axes(ax, channel_label("t", units) if k else "", force)
    return figure
