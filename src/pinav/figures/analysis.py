"""Figures of what was learned: potential, parts, trust, influence, sensitivity, laws.

They return the picture with its words, which is drawn when somebody looks at it. A map
is drawn on the grid of `field`, with the positions `path` [L] over it.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pinav.analysis import Discovery, HelmholtzSplit, LyapunovMap, SobolIndices
from pinav.evaluation import FieldMap, normal_quantile
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
    trust_map,
)
from pinav.figures.palette import BLACK, BLUE, GREY, ORANGE, VERMILLION
from pinav.figures.style import (
    DIMENSIONLESS,
    TEXT,
    add_legend,
    draw_panels,
    label_axes,
    new_figure,
    prepare_axes,
    with_unit,
)
from pinav.report import quantity
from pinav.units import force_unit


def potential_figure(
    potential: Float[np.ndarray, "rows columns"],
    field: FieldMap,
    *,
    origin: str,
    sd: Float[np.ndarray, "rows columns 2"] | None = None,
    **shown: Any,
) -> Picture:
    """A potential, and the signal to noise of its field.

    Args:
        potential: at the points of the map [L² T⁻²].
        field: the force that it belongs to.
        origin: of the potential, in words.
        sd: standard deviation of the field; without it the signal to noise is left out.
        shown: `path` and `units`, as of `map_panel`.
    """
    lifted = above_least(potential, field)
    panels = {
        f"(a) potential, {origin}": partial(
            map_panel, field, lifted, POTENTIAL, **shown
        )
    }
    caption = "Potential up to a constant."
    if sd is not None:
        panels["(b) signal to noise"] = partial(trust_map, field, sd, **shown)
        caption += (
            " Right: size of the field over its standard deviation; outside the marked "
            "line it is not significantly different from zero. Away from the data the "
            "standard deviation is that of the assumed prior and is not to be trusted."
        )
    size = 3.8 if sd is None else 7.5, 4.6
    return Picture(
        "analysis-potential",
        partial(draw_panels, size, panels, legend=2),
        caption,
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

    `spread` is the standard deviation of the fraction over posterior samples.
    """
    plus = "" if spread is None else f" ± {spread:.1%}"
    shown: dict[str, Any] = {"path": path, "units": units}
    top = largest_near(np.linalg.norm(field.force, axis=-1), field)
    part = partial(map_panel, field, look=FORCE, limits=(0.0, top), **shown)
    lifted = above_least(split.potential, field)
    panels = {
        f"(a) gradient: {split.gradient_fraction:.1%}{plus}": partial(
            part, values=split.gradient
        ),
        f"(b) rotational: {split.rotational_fraction:.1%}{plus}": partial(
            part, values=split.rotational
        ),
        "(c) potential of (a)": partial(map_panel, field, lifted, POTENTIAL, **shown),
    }
    reach = quantity(field.regions.near, units.get("x", ""))
    return Picture(
        "analysis-helmholtz",
        partial(draw_panels, (7.5, 3.9), panels, legend=2),
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
    """Change of the force [L T⁻²] without each of the `most` influential trajectories.

    `paths` are the observed positions of each trajectory [L].
    """
    near = field.distance <= field.regions.near
    sizes = np.linalg.norm(changes, axis=-1)
    order = np.argsort(-(sizes[:, near] ** 2).sum(axis=1))[:most]
    top = float(sizes[order][:, near].max()) or 1.0
    shown: dict[str, Any] = {"limits": (0.0, top), "units": units}
    panels = {
        f"without trajectory {index}": partial(
            map_panel, field, changes[index], CHANGE, path=paths[index], **shown
        )
        for index in order
    }
    columns = min(2, len(order))
    size = 2.9 * 2, 3.6 * -(-len(order) // columns)
    return Picture(
        "analysis-influence",
        partial(draw_panels, size, panels, columns=columns, legend=2),
        "Change of the learned field where the trajectory that is drawn is left out of "
        "the fit, to first order, the hyperparameters held.",
        "Change of the field where one trajectory is left out",
    )


def constants_figure(
    slopes: Mapping[str, Float[np.ndarray, "rows columns 2"]],
    field: FieldMap,
    **shown: Any,
) -> Picture:
    """Change of the force [L T⁻²] where a constant is one percent larger.

    Args:
        slopes: change of the force per percent of each constant.
        field: the force, for the grid and its distances.
        shown: `path` and `units`, as of `map_panel`.
    """
    look = dataclasses.replace(CHANGE, quantity=f"{CHANGE.quantity} per percent")
    panels = {
        f"{name} one percent larger": partial(map_panel, field, change, look, **shown)
        for name, change in slopes.items()
    }
    return Picture(
        "analysis-constants",
        partial(draw_panels, (max(2.7 * len(slopes), 4.0), 3.9), panels, legend=2),
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

    $\lambda$ is the finite-time Lyapunov exponent; all starts have the first velocity
    of the trajectory of this index.
    """
    horizon = with_unit(f"$T$ = {exponents.horizon:.4g}", units.get("t", "1"))
    draw = partial(growth_map, exponents, path=path, units=units)
    panels = {f"Growth of separations, {horizon}": draw}
    return Picture(
        "analysis-lyapunov",
        partial(draw_panels, (4.2, 4.6), panels),
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
    """The map of `lyapunov_figure`."""
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

    Outcomes that do not vary are left out; the caption says what was varied.
    """
    varying = np.flatnonzero(np.isfinite(indices.total).all(axis=1))
    panels = {indices.outcomes[i]: partial(_bars, indices, i) for i in varying}
    columns = min(max(len(varying), 1), 2)
    height = 1.2 + 0.34 * len(indices.factors)
    size = 2.9 * 2, height * max(-(-len(varying) // columns), 1)
    return Picture(
        "analysis-sobol",
        partial(draw_panels, size, panels, columns=columns, legend=2, sharey=True),
        caption,
        "Sobol' indices of the outcome of a rollout",
    )


def _bars(indices: SobolIndices, outcome: np.intp, *, ax: Axes) -> None:
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
    label_axes(ax, "fraction of the variance", "", legend=1)


CLOSE, FLOOR = 6.0, 0.5
"""Difference up to which laws are not told apart, and the shortest bar."""


def law_ranking(found: Discovery, *, ax: Axes | None = None) -> Axes:
    """Bars of the difference in BIC to the best law, on a logarithmic scale.

    Laws that are not told apart from the best one are blue, the others grey; those
    whose refit diverged are left out.
    """
    ax = prepare_axes(ax)
    laws = [law for law in found.candidates if np.isfinite(law.delta_bic)]
    lengths = [max(law.delta_bic, FLOOR) for law in laws]
    close = [law.name for law in found.close]
    ax.barh(
        [law.name for law in laws],
        [length - 0.9 * FLOOR for length in lengths],
        0.6,
        0.9 * FLOOR,
        color=[BLUE if law.name in close else GREY for law in laws],
    )
    ax.axvline(CLOSE, color=VERMILLION, lw=0.8, ls="--")
    ax.set_xscale("log")
    ax.set_xlim(0.9 * FLOOR, 2.0 * max(*lengths, 2 * CLOSE))
    ax.invert_yaxis()
    ax.tick_params(axis="y", length=0)
    return label_axes(ax, r"$\Delta$BIC (dashed: 6)", "")


def law_agreement(found: Discovery, *, ax: Axes | None = None) -> Axes:
    """The learned force against that of the best law, both components.

    Points are places in visited regions, bars 95 % intervals.
    """
    learned, sd, law = found.sample.force, found.sample.sd, found.best_force
    unit = force_unit(found.units)
    ax = prepare_axes(ax)
    for column, (label, color) in enumerate((("$F_x$", BLUE), ("$F_y$", ORANGE))):
        points = law[:, column], learned[:, column], normal_quantile() * sd[:, column]
        ax.errorbar(*points, fmt="o", ms=2.5, lw=0.6, color=color, label=label)
    span = (min(law.min(), learned.min()), max(law.max(), learned.max()))
    ax.plot(span, span, "-", color=GREY, lw=0.8, zorder=0)
    labels = with_unit("force of the law", unit), with_unit("learned", unit)
    return label_axes(ax, *labels, legend=1, loc="upper left")


def law_figure(found: Discovery) -> Picture:
    """Ranking of the laws beside the best one's agreement with the learned force."""
    panels = {
        "(a) candidate laws": partial(law_ranking, found),
        f"(b) {found.best.name} in visited regions": partial(law_agreement, found),
    }
    return Picture(
        "laws",
        partial(draw_panels, (7.5, 3.0), panels),
        "(a) Difference in BIC of laws refitted to the trajectories; laws in blue are "
        "not told apart, those in grey are, or extend the best one. (b) The best law "
        "and the learned force at points in visited regions, bars 95 %.",
        "Ranking of candidate laws, and the best one against the learned force",
    )


def formula_figure(formula: str, name: str, law: str) -> Picture | None:
    """The formula of a law in LaTeX, drawn; none where matplotlib cannot draw it."""
    if not formula or "matrix" in formula:
        return None

    def draw() -> Figure:
        figure = new_figure(6.5, 0.5)
        figure.text(0.5, 0.5, f"${formula}$", fontsize=11, ha="center", va="center")
        return figure

    return Picture(name, draw, f"Formula of the law: {law}.", width=0.8)


def evidence_bars(log_evidence: Mapping[str, float | None]) -> Figure:
    """By how much each model's log evidence is below the best, the best on top.

    Args:
        log_evidence: of each model [nats]; None where its fit failed.
    """
    known = {name: value for name, value in log_evidence.items() if value is not None}
    names = sorted(known, key=lambda name: known[name])
    best = max(known.values(), default=0.0)
    below = [best - known[name] for name in names]
    figure = new_figure(5.5, 0.8 + 0.35 * max(len(names), 1))
    ax = prepare_axes(figure.add_subplot())
    bars = ax.barh(names, below, color=BLUE, height=0.6)
    ax.bar_label(bars, [f"{value:.1f}" for value in below], padding=3, fontsize=8)
    ax.set_xscale("symlog", linthresh=1.0)
    ax.set_xlim(0.0, 10 * max([*below, 1.0]))
    label_axes(ax, "Δ log evidence to the best [nats]", "")
    return figure
