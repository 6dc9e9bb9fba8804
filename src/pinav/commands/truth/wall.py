"""Judging a bead above a wall, held there by its weight."""

import math
import time
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.commands.truth.cases import Case, Constants, Recording
from pinav.commands.truth.judged import Curve, Judgement
from pinav.commands.truth.metrics import TruthRow, compare_estimates, error_row
from pinav.dynamics import BrownianSwimmer, OverdampedSwimmer
from pinav.evaluation.truth import WallScore, boltzmann_force, wall_score
from pinav.fitting import Estimate, LangevinFit, fit_langevin, profile_environment
from pinav.fitting.langevin import (
    DiffusionField,
    KernelDiffusion,
    LearnedObservation,
    slow_reference,
)
from pinav.forces import KernelAxis, Warp, Weight, ZeroForce, stokes_drag
from pinav.trajectories import Trajectories

ALONG, ACROSS = (0.015, 0.025), (0.03, 0.05)
"""Bars: error of D along and across the wall with the bulk's D free, and given."""

APART = 10.0
"""Bar: distance of the walls that D along and across imply [nm]."""

RMS, WORST, WEIGHT_SD, WEIGHT_OFF = 2.5e-3, 5e-3, 0.9e-3, 2.5
"""Bars of the force [pN], and of the distance of the weight in its errors."""

NEAR = 0.1
"""Gap [radii] above which D counts; closer a step is as long as the Debye length."""

FORCE_FROM, FORCE_TO = 0.165, 1.32
"""Gaps [radii] between which the force is the weight alone."""

LEAST_FRAMES = 100
"""Frames between the two without which nothing is said of the weight."""

WARP = 0.026
"""Distance [radii] up to which the kernels are finest near the wall."""


class WallFields(NamedTuple):
    """Diffusion at heights of the centre, from the drifting wall.

    Attributes:
        heights: quantiles of those visited [um].
        along: D along the wall [um²/s].
        across: D normal to it.
        across_sd: its standard deviation.
    """

    heights: Float[np.ndarray, " height"]
    along: Float[np.ndarray, " height"]
    across: Float[np.ndarray, " height"]
    across_sd: Float[np.ndarray, " height"]


def judge_wall(case: Case, recording: Recording) -> Judgement:
    """Both mobilities against hydrodynamics, the force against the weight."""
    begun = time.perf_counter()
    constants = case.description.constants
    radius, heat = constants.radius_um, constants.heat
    assert radius is not None  # checked with the description
    assert heat is not None
    fit = fit_wall(recording, radius, heat)
    assert fit.reference is not None
    heights = recording.positions[:, 2] - fit.reference(recording.times)
    fields = wall_fields(fit, heights)
    free = [_score(fields, radius, normal=n) for n in (False, True)]
    contact = free[1].contact
    rows = [
        *mobility_rows(
            fields, radius, bulk_diffusion(constants), free, naive_fields(recording)
        ),
        *_force_rows(fit, heights - contact, contact, constants),
    ]
    notes = (*_notes(fit, free), *_boltzmann(heights - contact, radius, heat))
    seconds = time.perf_counter() - begun
    return Judgement(tuple(rows), (_curve(fields, free[1]),), notes, seconds)


def fit_wall(recording: Recording, radius: float, heat: float) -> LangevinFit:
    """Force along z and both diffusions over a wall that drifts slowly."""
    times, positions = recording.times, recording.positions
    data = Trajectories.from_arrays([times], [positions], channels=("x", "y", "z"))
    lowest = float(np.quantile(positions[:, 2], 0.002))
    axis = KernelAxis(2, warp=Warp(lowest, WARP * radius))
    environment = profile_environment(data, (axis,))
    swimmer = OverdampedSwimmer(ZeroForce(), environment, 1.0)
    return fit_langevin(
        BrownianSwimmer(swimmer, heat),
        data,
        diffusion=KernelDiffusion((axis,), groups=((0, 1), (2,))),
        observation=LearnedObservation(),
        reference=slow_reference(data, 2),
    )


def wall_fields(fit: LangevinFit, heights: Float[np.ndarray, " frame"]) -> WallFields:
    """Diffusion at 80 quantiles of the heights."""
    places = np.quantile(heights, np.linspace(0.01, 0.99, 80))
    points = np.zeros((80, 3))
    points[:, 2] = places
    assert isinstance(fit.diffusion, DiffusionField)
    values, sd = fit.diffusion(points), fit.diffusion.sd(points)
    return WallFields(places, values[:, 0], values[:, 2], sd[:, 2])


def naive_fields(recording: Recording) -> WallFields:
    """Diffusion of one lag in 80 bins of height: no blur, and a wall at rest."""
    steps = np.diff(recording.positions, axis=0)
    squares = steps**2 / (2 * np.diff(recording.times)[:, None])
    starts = recording.positions[:-1, 2]
    order = np.array_split(np.argsort(starts), 80)
    heights = np.array([starts[part].mean() for part in order])
    values = np.array([squares[part].mean(axis=0) for part in order])
    along, across = values[:, :2].mean(axis=1), values[:, 2]
    return WallFields(heights, along, across, across * np.sqrt(2 / len(order[0])))


def bulk_diffusion(constants: Constants) -> float | None:
    """Diffusion far from the wall, as stated or by Stokes and Einstein."""
    if constants.diffusion_um2_s is not None:
        return constants.diffusion_um2_s
    if constants.viscosity_mPa_s is None or constants.heat is None:
        return None
    assert constants.radius_um is not None
    return constants.heat / stokes_drag(constants.radius_um, constants.viscosity_mPa_s)


def _score(
    fields: WallFields, radius: float, *, normal: bool, bulk: float | None = None
) -> WallScore:
    return wall_score(
        fields.heights,
        fields.across if normal else fields.along,
        radius,
        normal=normal,
        bulk=bulk,
        least_gap=NEAR * radius,
    )


def mobility_rows(
    fields: WallFields,
    radius: float,
    bulk: float | None,
    free: list[WallScore],
    naive: WallFields,
) -> list[TruthRow]:
    """Both diffusions off hydrodynamics, and how far their walls are apart.

    Args:
        fields: the learned diffusions.
        radius: of the bead [um].
        bulk: D far from the wall, where it is known [um²/s].
        free: scores along and normal to the wall with the bulk's D free.
        naive: diffusions of one lag.
    """
    rows = []
    for name, bars, score, normal in (
        ("along", ALONG, free[0], False),
        ("normal to", ACROSS, free[1], True),
    ):
        words = f"D {name} the wall off hydrodynamics, D0"
        plain = _score(naive, radius, normal=normal).error
        rows.append(error_row(f"{words} free", score.error, bars[0], naive=plain))
        if bulk is not None:
            given = _score(fields, radius, normal=normal, bulk=bulk)
            plain = _score(naive, radius, normal=normal, bulk=bulk).error
            rows.append(error_row(f"{words} given", given.error, bars[1], naive=plain))
    apart = 1e3 * abs(free[0].contact - free[1].contact)
    rows.append(
        TruthRow(
            quantity="wall by D along and by D normal to it, apart [nm]",
            truth=0.0,
            learned=apart,
            bar=f"at most {APART:g} nm",
            met=apart <= APART,
        )
    )
    return rows


def _force_rows(
    fit: LangevinFit,
    gaps: Float[np.ndarray, " frame"],
    contact: float,
    constants: Constants,
) -> list[TruthRow]:
    """The force where it is the weight alone: rms, worst, and its mean."""
    if constants.density_excess_kg_m3 is None or constants.radius_um is None:
        return []
    radius = constants.radius_um
    if len(_far(gaps, radius)) < LEAST_FRAMES:
        return []
    weight = Weight(radius, constants.density_excess_kg_m3, [0.0, 0.0, -1.0])
    true = -float(weight.size)
    places = np.linspace(FORCE_FROM * radius, FORCE_TO * radius, 60)
    points = np.zeros((60, 3))
    points[:, 2] = places + contact
    environment = fit.model.environment
    force = jax.vmap(lambda x: environment(0.0, x, jnp.zeros_like(x)))
    off = np.asarray(force(jnp.asarray(points)))[:, 2] - true
    rms, worst = float(np.sqrt(np.mean(off**2))), float(np.abs(off).max())
    mean = _mean_force(fit, gaps, contact, radius)
    away = abs(mean.value - true) / mean.sd
    return [
        _small("force off the weight, rms [pN]", rms, RMS),
        _small("force off the weight, worst [pN]", worst, WORST),
        _small("own sd of the weight [pN]", mean.sd, WEIGHT_SD),
        compare_estimates(
            "mean force far from the wall [pN]",
            Estimate(true, 0.0),
            mean,
            bar=f"within {WEIGHT_OFF:g} sd",
            met=away <= WEIGHT_OFF,
        ),
    ]


def _small(quantity: str, value: float, most: float) -> TruthRow:
    return TruthRow(
        quantity=quantity,
        truth=0.0,
        learned=value,
        bar=f"at most {most:g}",
        met=value <= most,
    )


def _mean_force(
    fit: LangevinFit,
    gaps: Float[np.ndarray, " frame"],
    contact: float,
    radius: float,
) -> Estimate:
    """Force over the heights that were visited far from the wall, with its error."""
    far = np.quantile(_far(gaps, radius), np.linspace(0.01, 0.99, 50))
    points = jnp.zeros((50, 3)).at[:, 2].set(far + contact)
    posterior = fit.posterior

    def mean(parameters: jax.Array) -> jax.Array:
        environment = posterior.free(parameters).environment
        return jnp.mean(
            jax.vmap(lambda x: environment(0.0, x, jnp.zeros_like(x)))(points)[:, 2]
        )

    value, slope = jax.value_and_grad(mean)(jnp.asarray(posterior.mean))
    slope = np.asarray(slope)
    return Estimate(float(value), math.sqrt(slope @ posterior.covariance @ slope))


def _far(gaps: Float[np.ndarray, " frame"], radius: float) -> Float[np.ndarray, " far"]:
    """The gaps where the force is the weight alone."""
    return gaps[(gaps > FORCE_FROM * radius) & (gaps < FORCE_TO * radius)]


def _notes(fit: LangevinFit, free: list[WallScore]) -> tuple[str, ...]:
    assert fit.reference is not None
    notes = [
        f"The wall wanders by {1e3 * fit.reference.values.std():.0f} nm (sd over "
        f"{len(fit.reference.values)} knots; mean own sd "
        f"{1e3 * fit.reference.sd.mean():.0f} nm).",
        f"D0 along the wall {free[0].bulk:.4f}, normal to it {free[1].bulk:.4f} um²/s.",
        *(
            f"Exposure along axes {', '.join(map(str, one.axes))}: "
            f"{one.exposure.value / one.interval:.2f} frames; error "
            f"{1e3 * one.error.value:.1f} nm."
            for one in fit.observation
        ),
    ]
    if fit.checks is not None:
        notes.append(fit.checks.statement)
    return tuple(notes)


def _boltzmann(
    gaps: Float[np.ndarray, " frame"], radius: float, heat: float
) -> tuple[str, ...]:
    if len(_far(gaps, radius)) < LEAST_FRAMES:
        return ()
    low, high = FORCE_FROM * radius, FORCE_TO * radius
    force = boltzmann_force(gaps, low, high, heat)
    return (
        f"Boltzmann's law over {low:.2f} to {high:.2f} um: {1e3 * force.value:.1f} ± "
        f"{1e3 * force.sd:.1f} fN (sd).",
    )


def _curve(fields: WallFields, score: WallScore) -> Curve:
    return Curve(
        "diffusion normal to the wall, D0 free",
        ("gap [um]", "D [um²/s]"),
        fields.heights - score.contact,
        fields.across,
        fields.across_sd,
        score.theory,
        np.zeros_like(score.theory),
    )
