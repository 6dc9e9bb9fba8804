"""Judging a bead above a wall, held there by its weight."""

import dataclasses
import math
import time

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from validation.truth.cases import Case, Constants, Recording
from validation.truth.known import WallScore, boltzmann_force, wall_score
from validation.truth.metrics import (
    Curve,
    Judgement,
    TruthRow,
    compare_estimates,
    error_row,
)
from validation.truth.peer import is_installed
from validation.truth.wall_fields import (
    PeerFields,
    WallFields,
    ask_peer,
    fit_wall,
    naive_fields,
    wall_fields,
)

from pinav.fitting import Estimate, EvidenceFit
from pinav.forces import Weight, stokes_drag

ALONG, ACROSS = (0.015, 0.025), (0.03, 0.05)
"""Bars: error of D along and across the wall with the bulk's D free, and given."""

APART = 10.0
"""Bar: distance of the walls that D along and across imply [nm]."""

RMS, WORST, WEIGHT_SD, WEIGHT_OFF = 2.5e-3, 5e-3, 0.9e-3, 2.5
"""Bars of the force [pN], and of the distance of the weight in its errors."""

NEAR = 0.1
"""Gap [radii] above which D counts; closer a step is as long as the Debye length."""

FORCE_FROM, FORCE_TO = 0.25, 2.0
"""Gaps [um] between which the force is the weight alone: five Debye lengths of 50 nm,
whatever the radius, and where a light bead still goes."""

VISITED = 0.99
"""Quantile of the gaps beyond which nothing is said of the force."""

LEAST_FRAMES = 100
"""Frames between the two without which nothing is said of the weight."""


def judge_wall(case: Case, recording: Recording, *, peer: bool) -> Judgement:
    """Both mobilities against hydrodynamics, the force against the weight.

    The peer knows no wall that drifts: it is given the heights above the learned one.
    """
    begun = time.perf_counter()
    constants = case.description.constants
    radius, heat = constants.radius_um, constants.heat
    assert radius is not None  # checked with the description
    assert heat is not None
    fit = fit_wall(recording, radius, heat)
    assert fit.thermal.reference is not None
    heights = recording.positions[:, 2] - fit.thermal.reference(recording.times)
    fields = wall_fields(fit, heights)
    free = [_score(fields, radius, normal=n) for n in (False, True)]
    contact = free[1].contact
    notes = (*_notes(fit, free), *_boltzmann(heights - contact, heat))
    seconds = time.perf_counter() - begun
    other = None
    if peer and is_installed():
        other = ask_peer(recording, heights, heat, radius)
    rows = [
        *mobility_rows(
            fields,
            radius,
            bulk_diffusion(constants),
            free,
            naive_fields(recording),
            None if other is None else other.fields(fields),
        ),
        *_force_rows(fit, heights - contact, contact, constants, other),
    ]
    return Judgement(tuple(rows), (_curve(fields, free[1]),), notes, seconds)


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
        sd=fields.across_sd if normal else fields.along_sd,
        bulk=bulk,
        least_gap=NEAR * radius,
    )


def mobility_rows(
    fields: WallFields,
    radius: float,
    bulk: float | None,
    free: list[WallScore],
    naive: WallFields,
    other: WallFields | None = None,
) -> list[TruthRow]:
    """Both diffusions off hydrodynamics, and how far their walls are apart.

    Args:
        fields: the learned diffusions.
        radius: of the bead [um].
        bulk: D far from the wall, where it is known [um²/s].
        free: scores along and normal to the wall with the bulk's D free.
        naive: diffusions of one lag.
        other: those of the peer.
    """

    def error(fields: WallFields | None, bulk: float | None = None) -> float | None:
        if fields is None:
            return None
        return _score(fields, radius, normal=normal, bulk=bulk).error

    rows = []
    for name, bars, score, normal in (
        ("along", ALONG, free[0], False),
        ("normal to", ACROSS, free[1], True),
    ):
        words = f"D {name} the wall off hydrodynamics, D0"
        rows.append(
            error_row(
                f"{words} free",
                score.error,
                bars[0],
                naive=error(naive),
                peer=error(other),
            )
        )
        if bulk is not None:
            given = _score(fields, radius, normal=normal, bulk=bulk)
            rows.append(
                error_row(
                    f"{words} given",
                    given.error,
                    bars[1],
                    naive=error(naive, bulk),
                    peer=error(other, bulk),
                )
            )
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
    fit: EvidenceFit,
    gaps: Float[np.ndarray, " frame"],
    contact: float,
    constants: Constants,
    other: PeerFields | None,
) -> list[TruthRow]:
    """The force where it is the weight alone: rms, worst, and its mean."""
    if constants.density_excess_kg_m3 is None or constants.radius_um is None:
        return []
    far = _far(gaps)
    if len(far) < LEAST_FRAMES:
        return []
    weight = Weight(
        constants.radius_um, constants.density_excess_kg_m3, [0.0, 0.0, -1.0]
    )
    true = -float(weight.size)
    places = np.linspace(FORCE_FROM, far.max(), 60)
    points = np.zeros((60, 3))
    points[:, 2] = places + contact
    environment = fit.model.environment
    force = jax.vmap(lambda x: environment(0.0, x, jnp.zeros_like(x)))
    off = np.asarray(force(jnp.asarray(points)))[:, 2] - true
    rms, worst = float(np.sqrt(np.mean(off**2))), float(np.abs(off).max())
    mean = _mean_force(fit, far, contact)
    away = abs(mean.value - true) / mean.sd
    row = compare_estimates(
        "mean force far from the wall [pN]",
        Estimate(true, 0.0),
        mean,
        bar=f"within {WEIGHT_OFF:g} sd",
        met=away <= WEIGHT_OFF,
    )
    rest: tuple[float | None, ...] = (None, None)
    if other is not None:
        theirs = other.force(places + contact) - true
        rest = float(np.sqrt(np.mean(theirs**2))), float(np.abs(theirs).max())
        peer = float(other.force(far + contact).mean())
        row = dataclasses.replace(row, peer=peer)
    return [
        _small("force off the weight, rms [pN]", rms, RMS, rest[0]),
        _small("force off the weight, worst [pN]", worst, WORST, rest[1]),
        _small("own sd of the weight [pN]", mean.sd, WEIGHT_SD),
        row,
    ]


def _small(
    quantity: str, value: float, most: float, peer: float | None = None
) -> TruthRow:
    return TruthRow(
        quantity=quantity,
        truth=0.0,
        learned=value,
        bar=f"at most {most:g}",
        met=value <= most,
        peer=peer,
    )


def _mean_force(
    fit: EvidenceFit, far: Float[np.ndarray, " far"], contact: float
) -> Estimate:
    """Force over the gaps that were visited far from the wall, with its error."""
    places = np.quantile(far, np.linspace(0.01, 0.99, 50))
    points = jnp.zeros((50, 3)).at[:, 2].set(places + contact)
    posterior = fit.posterior

    def mean(parameters: jax.Array) -> jax.Array:
        environment = posterior.free(parameters).environment
        return jnp.mean(
            jax.vmap(lambda x: environment(0.0, x, jnp.zeros_like(x)))(points)[:, 2]
        )

    value, slope = jax.value_and_grad(mean)(jnp.asarray(posterior.mean))
    slope = np.asarray(slope)
    return Estimate(float(value), math.sqrt(slope @ posterior.covariance @ slope))


def _far(gaps: Float[np.ndarray, " frame"]) -> Float[np.ndarray, " far"]:
    """The gaps where the force is the weight alone."""
    most = min(FORCE_TO, float(np.quantile(gaps, VISITED)))
    return gaps[(gaps > FORCE_FROM) & (gaps < most)]


def _notes(fit: EvidenceFit, free: list[WallScore]) -> tuple[str, ...]:
    path = fit.thermal.reference
    assert path is not None
    notes = [
        f"The wall wanders by {1e3 * path.values.std():.0f} nm (sd over "
        f"{len(path.values)} knots; mean own sd {1e3 * path.sd.mean():.0f} nm).",
        f"D0 along the wall {free[0].bulk:.4f}, normal to it {free[1].bulk:.4f} um²/s.",
        *(
            f"Exposure along axes {', '.join(map(str, one.axes))}: "
            f"{one.exposure.value / one.interval:.2f} frames; error "
            f"{1e3 * one.error.value:.1f} nm."
            for one in fit.thermal.observation
        ),
    ]
    if fit.thermal.checks is not None:
        notes.append(fit.thermal.checks.statement)
    return tuple(notes)


def _boltzmann(gaps: Float[np.ndarray, " frame"], heat: float) -> tuple[str, ...]:
    far = _far(gaps)
    if len(far) < LEAST_FRAMES:
        return ()
    low, high = FORCE_FROM, float(far.max())
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
