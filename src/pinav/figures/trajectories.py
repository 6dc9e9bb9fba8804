"""Figures of trajectories, velocities, losses and forces along a path.

A panel takes arrays and an optional `ax`, draws and returns the `Axes`; a figure
arranges panels and returns the `Figure`. Nothing here loads, fits or shows.

Models are named as in the tables (`ude`, `ude-untrained`, `nn-only`, ...); the
name sets colour, dash and legend text. Any other name is its own legend text.
"""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from pinav.evaluation import Decomposition
from pinav.figures.palette import BLACK, FAINT, GREY, GUIDE, PAPER, SHADE, TRUTH
from pinav.figures.style import (
    DIMENSIONLESS,
    REACH,
    SMALL,
    THIN,
    WIDE,
    LineStyle,
    add_legend,
    channel_label,
    finite,
    frame_about,
    label_axes,
    label_plane,
    mark_line,
    new_figure,
    pale,
    prepare_axes,
    style_of,
    symbol,
    title_panel,
    with_unit,
)
from pinav.units import force_unit

PHASE_NAMES = 13.5
"""Height [pt] of the phase names above a loss curve, with what keeps them apart."""


def trajectory(
    truth: Float[np.ndarray, "time 2"],
    models: Mapping[str, Float[np.ndarray, "_ 2"]],
    *,
    units: Mapping[str, str] = DIMENSIONLESS,
    barrier: tuple[Sequence[float], float] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Paths in the plane, starts and ends marked.

    A model that strays far from the truth is cut at the frame, so that the truth
    stays readable; the legend then says where it ends, or that it diverged.

    Args:
        truth: true positions [L].
        models: positions of each model [L]; not-finite ones are left out.
        barrier: centre and width of an obstacle to outline, at one width.
    """
    ax = prepare_axes(ax)
    if barrier is not None:
        x, y = map(float, barrier[0])
        look = {"facecolor": SHADE, "edgecolor": GREY, "linestyle": (0, (1, 1.5))}
        look |= {"linewidth": 0.8, "zorder": 0, "label": "barrier (1σ)"}
        ax.add_patch(Circle((x, y), float(barrier[1]), **look))
        ax.plot(x, y, "+", color=GREY, markersize=5, zorder=0.5)
    truth = finite(truth)
    frame = frame_about(truth, *models.values())
    _draw_path(ax, truth, style_of("truth"), WIDE)
    for index, (name, positions) in enumerate(models.items()):
        style = style_of(name, index)
        note = _fate(np.asarray(positions), frame)
        style = dataclasses.replace(style, label=style.label + note)
        _draw_path(ax, _within_reach(positions, frame), style, THIN)
    observed = truth[np.isfinite(truth).all(1)]
    _mark(ax, observed[0], "o", "start", (6, -7))
    _mark(ax, observed[-1], "s", "end", (-6, -1))
    ax.set_xlim(*frame[:, 0], auto=True)
    ax.set_ylim(*frame[:, 1], auto=True)
    label_plane(ax, units)
    add_legend(ax)
    return ax


def _draw_path(ax: Axes, positions: np.ndarray, style: LineStyle, width: float) -> None:
    (line,) = ax.plot(
        *positions.T, style.dash, color=style.color, lw=width, label=style.label
    )
    last = positions[np.isfinite(positions).all(1)][-1:]
    ax.plot(*last.T, "s", color=line.get_color(), markersize=3.5)


def _mark(
    ax: Axes, point: np.ndarray, marker: str, name: str, offset: tuple[int, int]
) -> None:
    """A white marker with its name beside it, `offset` points away."""
    look = {"mfc": PAPER, "mec": BLACK, "markersize": 5, "zorder": 3}
    ax.plot(*point[:, None], marker, **look)
    ax.annotate(
        name,
        (float(point[0]), float(point[1])),
        offset,
        textcoords="offset points",
        ha="left" if offset[0] > 0 else "right",
        va="center",
        fontsize=SMALL,
        zorder=3,
    )


def _within_reach(positions: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """Positions without those so far off that a renderer would overflow."""
    positions = finite(positions)
    far = np.abs(positions) > 1e3 * (1.0 + np.abs(frame).max())
    return np.where(far.any(1, keepdims=True), np.nan, positions)


def _fate(positions: np.ndarray, frame: np.ndarray) -> str:
    """What the legend adds where the frame does not show how a path ends."""
    if not np.isfinite(positions).all():
        return "\n(diverged)"
    end = positions[-1]
    if ((end < frame[0]) | (end > frame[1])).any():
        return f"\n(ends at {end[0]:.3g}, {end[1]:.3g})".replace("-", "−")
    return ""


def velocity(
    times: Float[np.ndarray, " time"],
    truth: Float[np.ndarray, "time 2"],
    models: Mapping[str, Float[np.ndarray, "time 2"]],
    *,
    units: Mapping[str, str] = DIMENSIONLESS,
    ax: Axes | None = None,
) -> Axes:
    """Both velocity components over time: vx in full colour, vy in a pale one.

    Velocities of models that are not finite are left out.
    """
    ax = prepare_axes(ax, width=5.0)
    styles = [style_of("truth")]
    styles += [style_of(name, index) for index, name in enumerate(models)]
    curves = [finite(truth), *map(finite, models.values())]
    for style, curve in zip(styles, curves, strict=True):
        width = WIDE if style is styles[0] else THIN
        note = "" if np.isfinite(curve).all() else " (diverged)"
        for channel, values, color in zip(
            ("vx", "vy"), curve.T, (style.color, pale(style.color)), strict=True
        ):
            label = f"{symbol(channel)} {style.label}{note}"
            ax.plot(times, values, style.dash, color=color, lw=width, label=label)
    ax.set_ylim(*_value_range(curves[0], curves[1:]))
    labels = channel_label("t", units), with_unit("velocity", units.get("vx", "1"))
    return label_axes(ax, *labels, legend=len(curves), loc="upper right")


def _value_range(
    truth: np.ndarray, others: Iterable[np.ndarray]
) -> tuple[float, float]:
    """Limits that show all of the truth and others within `REACH` of it."""
    low, high = float(np.nanmin(truth)), float(np.nanmax(truth))
    reach = REACH * ((high - low) or 1.0)
    clipped = [np.clip(other, low - reach, high + reach) for other in others]
    everything = np.concatenate([truth.ravel(), *(part.ravel() for part in clipped)])
    low, high = float(np.nanmin(everything)), float(np.nanmax(everything))
    pad = 0.06 * (high - low or 1.0)
    return low - pad, high + pad


def loss_curve(
    losses: Float[np.ndarray, "*seed step"],
    phases: Sequence[tuple[str, int]],
    *,
    model: str = "ude",
    ax: Axes | None = None,
) -> Axes:
    """Training loss on a log scale, each phase named and its beginning marked.

    Args:
        losses: loss at each step of one fit, or of one fit per row: the first is
            bold. What is not a positive number leaves a gap.
        phases: name of each phase and the step at which it began.
        model: what was fitted; sets the colour.
    """
    ax = prepare_axes(ax)
    rows = np.atleast_2d(finite(losses))
    rows = np.where(rows > 0.0, rows, np.nan)
    steps = np.arange(rows.shape[1])
    color = style_of(model).color
    first = "first seed" if len(rows) > 1 else None
    ax.plot(steps, rows[0], color=color, lw=THIN, label=first, zorder=3)
    for index, row in enumerate(rows[1:]):
        label = f"{len(rows) - 1} more" if index == 0 else None
        ax.plot(steps, row, color=pale(color), lw=0.6, label=label)
    ax.set_yscale("log")
    ax.set_xlim(0, max(len(steps) - 1, 1))
    _mark_phases(ax, phases, len(steps) - 1)
    return label_axes(ax, "step", "training loss", legend=int(len(rows) > 1))


def _mark_phases(ax: Axes, phases: Sequence[tuple[str, int]], end: int) -> None:
    """A line where each later phase begins, and its name above its steps."""
    mark_line(ax, *(begin for _, begin in phases[1:]))
    begins = [begin for _, begin in phases]
    middles = [(a + b) / 2 for a, b in zip(begins, [*begins[1:], end], strict=True)]
    top = ax.secondary_xaxis("top")
    top.set_xticks(middles, [name for name, _ in phases])
    top.tick_params(
        length=0, pad=2, labelsize=SMALL, labelrotation=90 if len(phases) > 3 else 0
    )
    top.spines["top"].set_visible(False)


def decomposition(
    learned: Decomposition,
    component: int = 0,
    *,
    true: Decomposition | None = None,
    units: Mapping[str, str] = DIMENSIONLESS,
    ax: Axes | None = None,
) -> Axes:
    """One component of a(t) = propulsion + environment + drag along a trajectory.

    Of the truth the environment is drawn below.

    References:
        PI-NAV paper, addendum 3 (structural interpretability).
    """
    ax = prepare_axes(ax, width=5.0, height=2.6)
    ax.axhline(0.0, color=GUIDE, lw=0.6, zorder=0)
    total = np.sum(list(learned.terms.values()), axis=0)
    ax.plot(learned.times, total[:, component], color=FAINT, lw=WIDE, label="sum")
    if true is not None:
        values = true.terms["environment"][:, component]
        ax.plot(true.times, values, color=TRUTH, lw=WIDE, label="environment, true")
    for index, (name, values) in enumerate(learned.terms.items()):
        style = style_of(name, index)
        suffix = ", learned" if name == "environment" and true is not None else ""
        line = {"color": style.color, "lw": THIN, "label": style.label + suffix}
        ax.plot(learned.times, finite(values[:, component]), **line)
    label = with_unit(f"$a_{'xyz'[component]}$", force_unit(units))
    time = channel_label("t", units)
    return label_axes(ax, time, label, legend=2, loc="upper right")


def acceleration_figure(
    learned: Decomposition, *, true: Decomposition | None = None
) -> Figure:
    """The decomposition of the acceleration, x above y, dimensionless."""
    figure = new_figure(7.0, 4.4)
    upper, lower = figure.subplots(2, 1, sharex=True)
    for component, ax in enumerate((upper, lower)):
        decomposition(learned, component, true=true, ax=ax)
    lower.get_legend().remove()
    upper.set_xlabel("")
    return figure


def figure1(
    times: Float[np.ndarray, " time"],
    truth: Float[np.ndarray, "time 4"],
    untrained: Float[np.ndarray, "time 4"],
    trained: Float[np.ndarray, "time 4"],
    losses: Float[np.ndarray, "*seed step"],
    phases: Sequence[tuple[str, int]],
    *,
    model: str = "ude",
    barrier: tuple[Sequence[float], float] | None = None,
) -> Figure:
    """The paper's Figure 1, for one kind of model, dimensionless.

    Panels: (a) trajectory, truth and untrained; (b) the same, trained; (c) training
    loss; (d) velocity, truth and untrained; (e) the same, trained.

    Args:
        times: times [T].
        truth: true states (x, y, vx, vy).
        untrained: states of the model before training.
        trained: states of the model after training.
        losses: as for `loss_curve`.
        phases: as for `loss_curve`.
        model: `ude` or `nn-only`; sets colours and words.
        barrier: centre and width of an obstacle to outline.

    References:
        PI-NAV paper, Figure 1.
    """
    figure = new_figure(7.5, 5.6)
    axes = figure.subplot_mosaic("aabbcc;dddeee", height_ratios=(1.1, 1.0))
    panels = ((f"{model}-untrained", untrained, "ad"), (model, trained, "be"))
    for name, states, (path, speed) in panels:
        paths, speeds = {name: states[:, :2]}, {name: states[:, 2:]}
        trajectory(truth[:, :2], paths, barrier=barrier, ax=axes[path])
        velocity(times, truth[:, 2:], speeds, ax=axes[speed])
        label = style_of(name).label
        title_panel(axes[path], f"({path}) truth and {label}", pad=PHASE_NAMES)
        title_panel(axes[speed], f"({speed}) truth and {label}")
    loss_curve(losses, phases, model=model, ax=axes["c"])
    title_panel(axes["c"], "(c) training loss")
    return figure
