"""Candidate laws for the terms of a structured force, and where their fits begin.

A search for structure has found the coordinates of which a force is a function, so that
only the formula of each profile is open.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from pinav.analysis.discovery.force_sample import ForceSample, Sampling
from pinav.forces import (
    AbstractProfileTerm,
    AbstractTerm,
    CentralTerm,
    EllipticTerm,
    HillsTerm,
    LatticeTerm,
    LinearTerm,
    ObstaclesTerm,
    WallTerm,
)
from pinav.forces.geometries import Center, Ellipse, Landscape, Line
from pinav.forces.law_library import (
    ANISOTROPIC_TRAP,
    CONSTANT_FORCE,
    GAUSSIAN,
    HARMONIC,
    LATTICES,
    PLANE_WAVE,
    SADDLE,
    profile_laws,
    turn,
)
from pinav.forces.laws import AbstractLaw, SumLaw
from pinav.forces.terms import HARMONICS

MOST_TERMS = 3
"""Terms of a sum of laws at most."""


class TermLaws(eqx.Module):
    """A term of a learned force, and the laws that it may follow."""

    kind: str = eqx.field(static=True)
    sample: ForceSample
    laws: tuple[AbstractLaw, ...] = eqx.field(static=True)
    landscape: Landscape = eqx.field(static=True)


def term_laws(
    terms: Sequence[AbstractTerm], sampling: Sampling
) -> tuple[TermLaws, ...] | None:
    """The laws of each term; None without terms, or with too many or other ones."""
    kinds = [laws_of(term) for term in terms]
    if not 0 < len(terms) <= MOST_TERMS or not all(kinds):
        return None
    samples = [
        sampling.sample(lambda force, index=index: force.terms[index])
        for index in range(len(terms))
    ]
    return tuple(
        TermLaws(term.kind, sample, laws, term_landscape(term, sample))
        for term, laws, sample in zip(terms, kinds, samples, strict=True)
    )


def laws_of(term: AbstractTerm) -> tuple[AbstractLaw, ...]:
    """The laws that have the structure of a term; none where there are none."""
    match term:
        case CentralTerm():
            laws = profile_laws(Center())
        case EllipticTerm():
            laws = profile_laws(Ellipse())
        case WallTerm():
            laws = (*profile_laws(Line()), PLANE_WAVE)
        case ObstaclesTerm():
            laws = profile_laws(Center(count=len(term.centers)))
        case LatticeTerm():
            laws = LATTICES
        case LinearTerm() if term.rotational:
            laws = (HARMONIC,)
        case LinearTerm():
            laws = (CONSTANT_FORCE, HARMONIC, SADDLE, ANISOTROPIC_TRAP)
        case HillsTerm() if len(term.centers) <= MOST_TERMS and not term.rotational:
            laws = (SumLaw((GAUSSIAN,) * len(term.centers)),)
        case _:
            laws = ()
    return tuple(map(turn, laws)) if term.rotational else laws


def term_landscape(term: AbstractTerm, sample: ForceSample) -> Landscape:
    """Features of the geometry of a term from which fits of its laws start."""
    plain = sample.landscape
    features: dict[str, Any] = {}
    if isinstance(term, AbstractProfileTerm):
        features["lengths"] = _lengths(term, sample)
    match term:
        case CentralTerm() | EllipticTerm():
            features["centers"] = _points(term.center[None])
        case ObstaclesTerm() | HillsTerm():
            features["centers"] = _points(term.centers)
        case WallTerm():
            features |= {"centers": plain.centers[1:], "direction": float(term.angle)}
        case LatticeTerm():
            features["wave_vectors"] = _strongest_waves(term)
    if isinstance(term, EllipticTerm):
        p, q = (float(part) for part in term.shear)
        features["direction"] = 0.5 * float(np.arctan2(q, p))
        features["aspect"] = float(np.exp(-2 * np.hypot(p, q)))
    return dataclasses.replace(plain, **features)


def _points(places: Float[ArrayLike, "place 2"]) -> tuple[tuple[float, float], ...]:
    return tuple((float(x), float(y)) for x, y in np.asarray(places))


def _lengths(term: AbstractProfileTerm, sample: ForceSample) -> tuple[float, ...]:
    """Lengths about that over which a profile changes.

    A force about a centre is strongest at about that distance; one along a line is
    felt over about that width.
    """
    z = np.asarray(jax.vmap(term.coordinates)(jnp.asarray(sample.positions)))
    size = np.linalg.norm(sample.force, axis=1)
    if term.is_odd:
        strong = size >= np.quantile(size, 0.9)
        length = np.median(z.min(axis=1)[strong])
    else:
        weights = size / max(size.sum(), np.finfo(float).tiny)
        middle = weights @ z[:, 0]
        length = np.sqrt(weights @ (z[:, 0] - middle) ** 2)
    length = max(float(length), 0.02 * sample.extent)
    return tuple(factor * length for factor in (0.5, 1.0, 2.0))


def _strongest_waves(term: LatticeTerm) -> tuple[tuple[float, float], ...]:
    """The wave vectors of the two strongest harmonics of a lattice [rad L⁻¹]."""
    orders = np.array(HARMONICS, float)
    vectors = orders @ np.asarray(term.wave_vectors)
    weights = np.asarray(term.weights).reshape(2, -1)
    strength = np.hypot(*weights) * np.linalg.norm(vectors, axis=1)
    ranking = np.argsort(strength)[::-1]
    first = vectors[ranking[0]]
    areas = np.abs(first[0] * vectors[:, 1] - first[1] * vectors[:, 0])
    sines = areas / np.linalg.norm(first) / np.linalg.norm(vectors, axis=1)
    across = next(i for i in ranking[1:] if sines[i] > 0.1)
    return _points(np.stack([first, vectors[across]]))
