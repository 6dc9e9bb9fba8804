"""Judging a bead that is driven round a ring."""

import dataclasses
import math
import time
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from validation.truth.cases import Case, Recording
from validation.truth.known import RingTruth, ring_truth, steady_state
from validation.truth.metrics import (
    Curve,
    Judgement,
    TruthRow,
    compare_estimates,
    error_row,
)
from validation.truth.peer import PeerRing, infer_ring, is_installed

from pinav.dynamics import OverdampedSwimmer
from pinav.errors import InputError
from pinav.fitting import (
    Estimate,
    EvidenceFit,
    LearnedObservation,
    fit_langevin,
    profile_environment,
)
from pinav.forces import KernelAxis, ZeroForce
from pinav.trajectories import Trajectories

DRIFT, SPREAD, CURRENT, DENSITY, TURN = 0.025, 0.015, 0.02, 0.03, 0.01
"""Bars: drift off density and current, spread of D, current, density, mean drift."""

LOST = 0.4
"""Part of the frames that is left out to see whether D stays."""


class Ring(NamedTuple):
    """A ring in the unit of its positions.

    Attributes:
        period: of the positions.
        radius: that turns an angle into a length [um]; 1 where they are lengths.
        unit: of the positions.
    """

    period: float
    radius: float
    unit: str


class DriftOnRing(NamedTuple):
    """A learned drift at the places of the truth.

    Attributes:
        drift: there.
        sd: its standard deviation.
        diffusion: one number.
    """

    drift: Float[np.ndarray, " place"]
    sd: Float[np.ndarray, " place"]
    diffusion: Estimate


def judge_ring(case: Case, recording: Recording, *, peer: bool) -> Judgement:
    """Drift and diffusion against density and current; what they predict of both."""
    begun = time.perf_counter()
    ring, tracks = _ring_of(case), recording.positions
    interval = float(np.median(np.diff(recording.times)))
    truth = ring_truth(tracks.T, interval, ring.period)
    fit = fit_ring(recording, ring.period)
    learned = drift_on_ring(fit, truth.angles)
    naive, naive_diffusion = _naive(tracks, interval, ring.period, truth.angles)
    density, current = steady_state(
        learned.drift, np.full_like(truth.angles, learned.diffusion.value), ring.period
    )
    seconds = time.perf_counter() - begun
    other = None
    if peer and is_installed():
        other = infer_ring(recording.times, tracks, ring.period, truth.angles)
    known = truth.drift(learned.diffusion.value)
    naive_known = truth.drift(naive_diffusion)
    rows = (
        *(
            _drift_row(truth, learned, (naive, naive_known), other, weighted=weighted)
            for weighted in (True, False)
        ),
        _spread_row(fit, recording, ring),
        _diffusion_row(truth, learned, ring, naive_diffusion, other),
        _relative("current [1/s]", truth.mean_current, current, CURRENT),
        error_row("density predicted, L1", _density_error(truth, density), DENSITY),
        _relative(
            f"mean drift over a turn [{ring.unit}/s]",
            Estimate(float(known.mean()), _mean_sd(truth, learned)),
            float(learned.drift.mean()),
            TURN,
        ),
    )
    return Judgement(rows, (_curve(truth, learned, ring),), _notes(fit), seconds)


def fit_ring(recording: Recording, period: float) -> EvidenceFit:
    """A free drift and one diffusion, with blur and error learned.

    Args:
        recording: one column for each track; NaN where a frame is lost.
        period: of the positions.
    """
    columns = recording.positions.T
    observed = [np.isfinite(column) for column in columns]
    data = Trajectories.from_arrays(
        [recording.times[kept] for kept in observed],
        [c[kept][:, None] for c, kept in zip(columns, observed, strict=True)],
        channels=("x",),
    )
    environment = profile_environment(data, (KernelAxis(0, period),))
    swimmer = OverdampedSwimmer(ZeroForce(), environment, 1.0)
    return fit_langevin(swimmer, data, observation=LearnedObservation(), einstein=False)


def drift_on_ring(fit: EvidenceFit, places: Float[np.ndarray, " place"]) -> DriftOnRing:
    """The learned drift at some places.

    Raises:
        InputError: diffusion is a field.
    """
    if not isinstance(fit.thermal.diffusion, Estimate):
        raise InputError("drift_on_ring: expected a fit with one diffusion")
    points = jnp.asarray(places)[:, None]
    environment = fit.model.environment
    drift = jax.vmap(lambda x: environment(0.0, x, jnp.zeros_like(x)))(points)
    sd = fit.posterior.force_sd(np.asarray(points))
    return DriftOnRing(np.asarray(drift)[:, 0], sd[:, 0], fit.thermal.diffusion)


def _ring_of(case: Case) -> Ring:
    description, constants = case.description, case.description.constants
    period = constants.period or 2 * math.pi
    if description.length_unit != "rad":
        return Ring(period, 1.0, "um")
    return Ring(period, constants.ring_radius_um or 1.0, "rad")


def _naive(
    tracks: Float[np.ndarray, "frame track"],
    interval: float,
    period: float,
    places: Float[np.ndarray, " place"],
) -> tuple[np.ndarray, float]:
    """Drift and diffusion of one lag: least squares on harmonics, mean square."""

    def waves(x: np.ndarray) -> np.ndarray:
        phases = 2 * np.pi / period * x[:, None] * np.arange(1, 7)
        parts = [np.ones((len(x), 1)), np.cos(phases), np.sin(phases)]
        return np.concatenate(parts, axis=1)

    steps, starts = np.diff(tracks, axis=0).ravel(), tracks[:-1].ravel()
    observed = np.isfinite(steps)
    columns, steps = waves(starts[observed]), steps[observed]
    weights = np.linalg.solve(columns.T @ columns, columns.T @ steps) / interval
    rest = steps - interval * (columns @ weights)
    return waves(places) @ weights, float(np.mean(rest**2) / (2 * interval))


def _drift_row(
    truth: RingTruth,
    learned: DriftOnRing,
    naive: tuple[np.ndarray, np.ndarray],
    other: PeerRing | None,
    *,
    weighted: bool,
) -> TruthRow:
    known = truth.drift(learned.diffusion.value)
    rest = None
    if other is not None:
        rest = truth.distance(other.drift, known, weighted=weighted)
    place = "weighted by density" if weighted else "uniform"
    return error_row(
        f"drift off density and current, {place}",
        truth.distance(learned.drift, known, weighted=weighted),
        DRIFT,
        naive=truth.distance(*naive, weighted=weighted),
        peer=rest,
    )


def _spread_row(fit: EvidenceFit, recording: Recording, ring: Ring) -> TruthRow:
    """D of all frames, of every second and third, and with 40 % of them lost."""
    assert isinstance(fit.thermal.diffusion, Estimate)
    assert fit.thermal.checks is not None
    ratios = [1.0, *(one.ratio.value for one in fit.thermal.checks.thinned)]
    positions = recording.positions.copy()
    random = np.random.default_rng(0)
    positions[random.random(positions.shape) < LOST] = np.nan
    positions[[0, -1]] = recording.positions[[0, -1]]
    again = fit_ring(Recording(recording.times, positions, None), ring.period)
    assert isinstance(again.thermal.diffusion, Estimate)
    ratios.append(again.thermal.diffusion.value / fit.thermal.diffusion.value)
    spread = max(ratios) - min(ratios)
    return error_row("spread of D: all, 2nd, 3rd frame, 40 % lost", spread, SPREAD)


def _diffusion_row(
    truth: RingTruth,
    learned: DriftOnRing,
    ring: Ring,
    naive: float,
    other: PeerRing | None,
) -> TruthRow:
    scale = ring.radius**2
    known, without_route = (
        Estimate(scale * e.value, scale * e.sd)
        for e in (truth.diffusion_of(learned.drift), learned.diffusion)
    )
    met = abs(known.value - without_route.value) <= 2 * math.hypot(
        known.sd, without_route.sd
    )
    row = compare_estimates(
        "D against the drift's route [um²/s]",
        known,
        without_route,
        bar="within 2 sd",
        met=met,
        naive=scale * naive,
    )
    if other is None:
        return row
    return dataclasses.replace(row, peer=scale * other.diffusion)


def _relative(quantity: str, known: Estimate, learned: float, most: float) -> TruthRow:
    return TruthRow(
        quantity=quantity,
        truth=known.value,
        truth_sd=known.sd,
        learned=learned,
        bar=f"within {100 * most:g} %",
        met=abs(learned / known.value - 1) <= most,
    )


def _density_error(truth: RingTruth, density: np.ndarray) -> float:
    step = truth.period / len(density)
    return float(np.abs(density - truth.density).sum() * step)


def _mean_sd(truth: RingTruth, learned: DriftOnRing) -> float:
    density, slope, current = np.moveaxis(truth.samples, 1, 0)
    means = (current / density + learned.diffusion.value * slope).mean(axis=1)
    return float(means.std())


def _curve(truth: RingTruth, learned: DriftOnRing, ring: Ring) -> Curve:
    diffusion = learned.diffusion.value
    return Curve(
        "drift on the ring",
        (f"place [{ring.unit}]", f"drift [{ring.unit}/s]"),
        truth.angles,
        learned.drift,
        learned.sd,
        truth.drift(diffusion),
        truth.drift_sd(diffusion),
    )


def _notes(fit: EvidenceFit) -> tuple[str, ...]:
    observed = fit.thermal.observation[0]
    fraction = observed.exposure.value / observed.interval
    notes = [
        f"Effective exposure {fraction:.2f} frames, localisation error "
        f"{observed.error.value:.2g} in the unit of the positions; where D is constant "
        "the two trade off, and D does not depend on it."
    ]
    if fit.thermal.checks is not None:
        notes.append(fit.thermal.checks.statement)
    return tuple(notes)
