"""Figures of what was learned: potential, parts, trust, influence and sensitivity.

They return the picture with its words, which is drawn when somebody looks at it.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pinav.analysis import HelmholtzSplit, LyapunovMap, SobolIndices
from pinav.evaluation import FieldMap
from pinav.figures.images import Picture
from pinav.figures.maps import (
    CHANGE,
    FORCE,
    GROWTH,
    POTENTIAL,
    Path,
    above_least,
    largest_near,
    map_panel,
    one_legend,
    trust_map,
)
from pinav.figures.palette import (
    BLACK,
    BLUE,
    ORANGE,
    VERMILLION,
)
from pinav.figures.style import (
    DIMENSIONLESS,
    TEXT,
    add_legend,
    label_axes,
    new_figure,
    prepare_axes,
    share_legend,
    title_panel,
    with_unit,
)
from pinav.report import quantity


def potential_figure(
    potential: Float[np.ndarray, "rows columns"],
    field: FieldMap,
    *,
    origin: str,
    sd: Float[np.ndarray, "rows columns 2"] | None = None,
    path: Path | None = None,
    units: Mapping[str, str] = DIMENSIONLESS,
) -> Picture:
    """A potential, and where the field is known.

    Args:
        potential: positions to overlay [L].
        field: as there.
        origin: of the potential, in words.
        sd: of the field; without it the signal to noise is left out.
        path: as there.
        units: as there.
    """

    def draw() -> Figure:
        figure = new_figure(3.8 if sd is None else 7.5, 4.6)
        axes = np.ravel(figure.subplots(1, 1 if sd is None else 2))
        shown = {"path": path, "units": units}
        map_panel(field, above_least(potential, field), POTENTIAL, **shown, ax=axes[0])
        title_panel(axes[0], f"(a) potential, {origin}")
        if sd is not None:
            trust_map(field, sd, **shown, ax=axes[1])
            title_panel(axes[1], "(b) signal to noise")
        one_legend(figure, axes)
        return figure

    known = (
        " Right: size of the field over its standard deviation; outside the marked "
        "line it is not significantly different from zero. Away from the data the "
        "standard deviation is that of the assumed prior and is not to be trusted."
    )
    return Picture(
        "analysis-potential",
        draw,
        "Potential up to a constant." + ("" if sd is None else known),
        "Potential, and where the field is known",
    )


def helmholtz_figure(
    split: HelmholtzSplit,
    field: FieldMap,
    *,
    spread: float | None = None,
    path: Path | None = None,
    units: Mapping[str, str] = DIMENSIONLESS,
) -> Picture:
    """Gradient part, rotational part and potential of a force, with their fractions.

    Args:
        split: of the force.
        field: the force that was split.
        spread: standard deviation of the fraction over posterior samples.
        path: positions to overlay [L].
        units: unit of each channel; "1" means dimensionless.
    """
    fractions = (
        (split.gradient, f"(a) gradient: {split.gradient_fraction:.1%}"),
        (split.rotational, f"(b) rotational: {split.rotational_fraction:.1%}"),
    )

    def draw() -> Figure:
        figure = new_figure(7.5, 3.9)
        axes = figure.subplots(1, 3)
        top = largest_near(np.linalg.norm(field.force, axis=-1), field)
        plus = "" if spread is None else f" ± {spread:.1%}"
        shown = {"path": path, "units": units}
        for ax, (part, title) in zip(axes, fractions, strict=False):
            map_panel(field, part, FORCE, limits=(0.0, top), **shown, ax=ax)
            title_panel(ax, title + plus)
        lifted = above_least(split.potential, field)
        map_panel(field, lifted, POTENTIAL, **shown, ax=axes[2])
        title_panel(axes[2], "(c) potential of (a)")
        one_legend(figure, axes)
        return figure

    reach = quantity(field.regions.near, units.get("x", ""))
    return Picture(
        "analysis-helmholtz",
        draw,
        "Helmholtz split of the learned field, by least squares in the region within "
        f"{reach} of the data. Fractions are of the square of the field there. "
        "Harmonic fields are both; they are shared equally.",
        "Gradient part and rotational part of the learned field",
    )


def influence_figure(
    changes: Float[np.ndarray, "trajectory rows columns 2"],
    field: FieldMap,
    paths: Sequence[Path],
    *,
    most: int = 4,
    units: Mapping[str, str] = DIMENSIONLESS,
) -> Picture:
    """How the force would change without each of the most influential trajectories.

    Args:
        changes: of the force, where one trajectory is left out [L T⁻²].
        field: the force, for the grid and its distances.
        paths: observed positions of each trajectory [L].
        most: how many trajectories are shown.
        units: unit of each channel; "1" means dimensionless.
    """
    near = field.distance <= field.regions.near
    sizes = np.linalg.norm(changes, axis=-1)
    order = np.argsort(-(sizes[:, near] ** 2).sum(axis=1))[:most]
    top = float(sizes[order][:, near].max()) or 1.0
    columns = min(2, len(order))
    rows = -(-len(order) // columns)

    def draw() -> Figure:
        figure = new_figure(2.9 * 2, 3.6 * rows)
        axes = np.ravel(figure.subplots(rows, columns))
        for ax, index in zip(axes, order, strict=False):
            shown = {"path": paths[index], "units": units, "ax": ax}
            map_panel(field, changes[index], CHANGE, limits=(0.0, top), **shown)
            title_panel(ax, f"without trajectory {index}")
        for ax in axes[len(order) :]:
            ax.set_visible(False)
        one_legend(figure, axes)
        return figure

    return Picture(
        "analysis-influence",
        draw,
        "Change of the learned field where the trajectory that is drawn is left out of "
        "the fit, to first order, the hyperparameters held.",
        "Change of the field where one trajectory is left out",
    )


def constants_figure(
    slopes: Mapping[str, Float[np.ndarray, "rows columns 2"]],
    field: FieldMap,
    *,
    path: Path | None = None,
    units: Mapping[str, str] = DIMENSIONLESS,
) -> Picture:
    """How the force changes where a constant is one percent larger.

    Args:
        slopes: change of the force per percent of each constant [L T⁻²].
        field: the force, for the grid and its distances.
        path: positions to overlay [L].
        units: unit of each channel; "1" means dimensionless.
    """
    look = dataclasses.replace(CHANGE, quantity=f"{CHANGE.quantity} per percent")

    def draw() -> Figure:
        figure = new_figure(max(2.7 * len(slopes), 4.0), 3.9)
        axes = np.ravel(figure.subplots(1, len(slopes)))
        for ax, (name, change) in zip(axes, slopes.items(), strict=True):
            map_panel(field, change, look, path=path, units=units, ax=ax)
            title_panel(ax, f"{name} one percent larger")
        one_legend(figure, axes)
        return figure

    return Picture(
        "analysis-constants",
        draw,
        "Change of the learned field where a constant is one percent larger and "
        "everything else is fitted anew.",
        "Change of the field with known constants",
    )


def lyapunov_figure(
    exponents: LyapunovMap,
    *,
    trajectory: int = 0,
    path: Path | None = None,
    units: Mapping[str, str] = DIMENSIONLESS,
) -> Picture:
    r"""Growth $e^{\lambda T}$ of separations, over the starts of rollouts.

    $\lambda$ is the finite-time Lyapunov exponent.

    Args:
        exponents: the map.
        trajectory: index of the one whose first velocity all starts have.
        path: positions to overlay [L].
        units: unit of each channel; "1" means dimensionless.
    """

    def draw() -> Figure:
        figure = new_figure(4.2, 4.6)
        ax = growth_map(exponents, path=path, units=units, ax=figure.subplots())
        horizon = with_unit(f"$T$ = {exponents.horizon:.4g}", units.get("t", "1"))
        title_panel(ax, f"Growth of separations, {horizon}")
        return figure

    return Picture(
        "analysis-lyapunov",
        draw,
        "Growth of the separation of two rollouts of the model that start side by "
        f"side, with the velocity of trajectory {trajectory} at its start; its "
        "logarithm over the time is the finite-time Lyapunov exponent. Ridges separate "
        "starts with different fates.",
        "Growth of separations over starts",
        width=0.6,
    )


def growth_map(
    exponents: LyapunovMap,
    *,
    path: Path | None = None,
    units: Mapping[str, str] = DIMENSIONLESS,
    ax: Axes | None = None,
) -> Axes:
    """The map of `lyapunov_figure`.

    Args:
        exponents: as there.
        path: as there.
        units: as there.
        ax: where to draw; a new figure unless given.
    """
    values = np.where(exponents.separation > 0, exponents.separation, np.nan)
    low, high = (float(f(values)) for f in (np.nanmin, np.nanmax))
    limits = min(low, 0.9 * high), max(high, 1.1 * low)
    ax = map_panel(exponents, values, GROWTH, limits=limits, units=units, ax=ax)
    if path is not None:
        ax.plot(*path.T, color=VERMILLION, lw=1.2, label="reference trajectory")
        ax.plot(*path[0], "o", color=VERMILLION, ms=4, mec=BLACK, mew=0.5)
        add_legend(ax, loc="upper left")
        ax.set(xlim=exponents.x[[0, -1]], ylim=exponents.y[[0, -1]])
    return ax


def sobol_figure(indices: SobolIndices, caption: str = "") -> Picture:
    """First-order and total Sobol' indices with intervals, one panel per outcome.

    Args:
        indices: of all outcomes; those that do not vary are left out.
        caption: what was varied, and what the outcomes are.
    """

    def draw() -> Figure:
        varying = np.flatnonzero(np.isfinite(indices.total).all(axis=1))
        count = max(len(varying), 1)
        height = 1.2 + 0.34 * len(indices.factors)
        columns = min(count, 2)
        rows = -(-count // columns)
        figure = new_figure(2.9 * 2, height * rows)
        axes = np.ravel(figure.subplots(rows, columns, sharey=True))
        for ax, outcome in zip(axes, varying, strict=False):
            _bars(prepare_axes(ax), indices, int(outcome))
        for ax in axes[len(varying) :]:
            ax.set_visible(False)
        handles, labels = axes[0].get_legend_handles_labels()
        share_legend(figure, handles, labels=labels)
        return figure

    alt = "Sobol' indices of the outcome of a rollout"
    return Picture("analysis-sobol", draw, caption, alt)


def _bars(ax: Axes, indices: SobolIndices, outcome: int) -> None:
    places = np.arange(len(indices.factors))
    for shift, name, color, values, interval in (
        (-0.2, "first order", BLUE, indices.first, indices.first_interval),
        (0.2, "total", ORANGE, indices.total, indices.total_interval),
    ):
        value, (low, high) = values[outcome], interval[outcome].T
        error = np.maximum([value - low, high - value], 0.0)
        ax.barh(
            places + shift,
            value,
            0.36,
            xerr=error,
            color=color,
            label=f"{name}, with {indices.confidence:.0%} interval",
            error_kw={"lw": 0.9, "capsize": 2.0, "ecolor": BLACK},
        )
    ax.set_yticks(places, indices.factors, fontsize=TEXT)
    ax.set_ylim(len(places) - 0.5, -0.5)
    ax.axvline(0.0, color=BLACK, lw=0.6)
    label_axes(ax, "fraction of the variance", "")
    title_panel(ax, indices.outcomes[outcome])
