"""Figures of a fit: its paths, its force, the profiles of terms, learning."""

import dataclasses
from collections.abc import Iterator, Mapping

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pinav.evaluation import normal_interval
from pinav.figures.bands import band
from pinav.figures.images import Picture
from pinav.figures.maps import force_comparison
from pinav.figures.navigation import greatest_force, paths_map, spread_map
from pinav.figures.palette import GREEN, GREY, LEARNED, PURPLE, TRUTH
from pinav.figures.recordings import observed_paths, positions_over_time
from pinav.figures.style import (
    DIMENSIONLESS,
    add_legend,
    channel_label,
    label_axes,
    new_figure,
    title_panel,
    with_unit,
)
from pinav.figures.trajectories import loss_curve
from pinav.learning.findings import Findings, FoundTerm, Rollouts
from pinav.navigation.adaptive.flight import ShownFlight
from pinav.navigation.maps import Course
from pinav.trajectories import POSITION_CHANNELS
from pinav.units import force_unit

SMALL = (4.2, 2.6)
"""Width and height of the figure of one band [inch]."""

STRAIGHT = ("wall", "shear layer")
"""Terms whose coordinate is no distance."""


def fit_figure(fit: Findings) -> Picture:
    """All trajectories with rollouts, and the loss where the recipe has one."""
    losses, rollouts = fit.losses, fit.rollouts
    pieces = list(_pieces(rollouts))

    def draw() -> Figure:
        figure = new_figure(4.2 if losses is None else 7.5, 3.4)
        axes = figure.subplots(1, 1 if losses is None else 2, squeeze=False)[0]
        observed = [positions for _, positions, _ in pieces]
        predicted = [ys[:, :2] for _, _, ys in pieces]
        if sum(name in POSITION_CHANNELS for name in rollouts.channels) == 1:
            name = rollouts.channels[0]
            positions_over_time(
                [times for times, _, _ in pieces],
                [one[:, 0] for one in observed],
                [one[:, 0] for one in predicted],
                labels=(
                    with_unit("time", fit.units.get("t", "1")),
                    with_unit(name, fit.units.get(name, "1")),
                ),
                ax=axes[0],
            )
        else:
            observed_paths(observed, predicted, units=fit.units, ax=axes[0])
        if losses is not None:
            loss_curve(losses.values, losses.phases, ax=axes[1])
        return figure

    caption = "Observed positions and rollouts of the fitted model."
    if losses is not None:
        caption += " Right: training loss."
    return Picture(
        "fit", draw, caption, "Observed trajectories and rollouts of the model"
    )


def _pieces(
    rollouts: Rollouts,
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Times, observed positions and predicted states of each trajectory."""
    for index, length in enumerate(rollouts.lengths):
        states, seen = rollouts.states[index, :length], rollouts.observed[index]
        observed = np.where(seen[:length, :2], states[:, :2], np.nan)
        yield (
            rollouts.times[index, :length],
            observed,
            rollouts.predicted[index, :length],
        )


def learned_force_figure(fit: Findings) -> Picture | None:
    """Maps of the force, its truth and its uncertainty; None without a plane."""
    maps = fit.force
    if maps is None:
        return None
    learned = maps.learned
    gap = np.full((1, 2), np.nan)
    path = [part for _, seen, _ in _pieces(fit.rollouts) for part in (seen, gap)]

    def draw() -> Figure:
        return force_comparison(
            learned,
            true=maps.truth,
            sd=maps.sd,
            path=np.concatenate(path),
            units=fit.units,
        )

    unit = fit.units.get("x", "1")
    return Picture(
        "force",
        draw,
        "The force of the environment on a swimmer at rest. Hatched: unvisited, an "
        f"extrapolation ({learned.regions.definition(unit)}).",
        "Maps of the learned force and of how well it is known",
    )


def force_line_figures(fit: Findings) -> list[Picture]:
    """The force along lines through data that are not planar."""
    return [_force_line_figure(fit, name) for name in fit.lines or {}]


def _force_line_figure(fit: Findings, name: str) -> Picture:
    assert fit.lines is not None
    line = fit.lines[name]

    def draw() -> Figure:
        figure = new_figure(*SMALL)
        axes = figure.add_subplot()
        sd = np.zeros_like(line.force) if line.sd is None else line.sd
        units = fit.units.get(name, "1"), fit.units.get("force", "?")
        _force_band(axes, name, line.places, line.force, sd, units)
        if line.true is not None:
            axes.plot(line.places, line.true, color=TRUTH, lw=1.0, ls="--")
        return figure

    caption = f"The force along {name} through the middle of the data"
    if line.true is not None:
        caption += "; dashed: the truth"
    return Picture(f"force-{name}", draw, f"{caption}.", f"Force over {name}")


def _force_band(
    ax: Axes,
    coordinate: str,
    places: np.ndarray,
    mean: np.ndarray,
    sd: np.ndarray,
    units: tuple[str, str],
) -> None:
    """A force along a coordinate with its band; units of length and of force."""
    labels = with_unit(coordinate, units[0]), with_unit("force", units[1])
    band(places, mean, normal_interval(mean, sd), labels=labels, ax=ax)
    ax.axhline(0.0, color=GREY, lw=0.6)


def profile_figure(index: int, term: FoundTerm, fit: Findings) -> Picture | None:
    """The profile of a term with its band; None of a term that has none."""
    profile = term.profile
    if profile is None:
        return None
    length = fit.units.get("x", "1")

    def draw() -> Figure:
        figure = new_figure(*SMALL)
        coordinate = "along the normal" if term.name in STRAIGHT else "distance"
        curve = profile.places, profile.force, profile.sd
        units = length, force_unit(fit.units)
        _force_band(figure.add_subplot(), coordinate, *curve, units)
        return figure

    return Picture(
        f"profile-{index}",
        draw,
        f"The force of the term '{term.name}' with its band of 95 %.",
        f"Profile of the term {term.name}",
    )


def thermal_figures(fit: Findings) -> list[Picture]:
    """Diffusion along lines through the data, and the path of a reference."""
    thermal = fit.thermal
    if thermal is None:
        return []
    pictures = [_diffusion_figure(fit, name) for name in thermal.lines]
    path = thermal.reference
    if path is None:
        return pictures
    length, time = fit.units.get("x", "1"), fit.units.get("t", "1")

    def draw() -> Figure:
        figure = new_figure(*SMALL)
        band(
            path.times,
            path.values,
            normal_interval(path.values, path.sd),
            labels=(with_unit("time", time), with_unit("reference", length)),
            ax=figure.add_subplot(),
        )
        return figure

    caption = "Path of the frame of reference, about its mean, with its 95 % band."
    return [*pictures, Picture("reference", draw, caption, "Path of the reference")]


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

    def draw() -> Figure:
        figure = new_figure(*SMALL)
        ax = figure.add_subplot()
        colors = LEARNED, GREEN, PURPLE
        for color, group in zip(colors, columns.values(), strict=False):
            along = ", ".join(channels[index] for index in group)
            mean, sd = line.values[:, group[0]], line.sd[:, group[0]]
            shown = {"color": color, "name": f"along {along}", "labels": labels}
            band(line.places, mean, normal_interval(mean, sd), **shown, ax=ax)
        ax.set_ylim(bottom=0.0)
        if len(columns) > 1:
            add_legend(ax)
        return figure

    caption = f"Diffusion along {name} through the middle of the data, 95 % bands."
    return Picture(f"diffusion-{name}", draw, caption, f"Diffusion over {name}")


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
