"""Laws that the profiles of a structure may follow, by the evidence of the data.

Of each kind of law the one next to the profile of a fit is polished, and kept where the
evidence gains more than its numbers cost; the kernels of the profile stay beside it.
"""

import dataclasses
import functools
from collections.abc import Iterator

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Scalar, on_device
from pinav.fitting.policy import POLICY
from pinav.fitting.structure.response import ForceResponse
from pinav.fitting.structure.search import simplify
from pinav.fitting.structure.starts import Region
from pinav.fitting.structure.trials import (
    Proposal,
    Terms,
    coordinates,
    polish,
    with_places,
    with_profiles,
)
from pinav.forces import AbstractProfileTerm, LinearTerm
from pinav.forces.fitted_laws import FittedLaw
from pinav.forces.fitted_numbers import Span
from pinav.forces.profiles import DISTANCES, FITTED, LINES

POINTS, PROMISING = 200, 2
"""Data at whose coordinates laws are compared with a profile; and the kinds of laws
nearest to it that are polished."""

KINDS = 2.0
"""Nats by which a law may lose, the logarithm of the number of kinds and a little more:
where the evidence cannot tell, the formula is simpler than kernels that explain as
much, and says more where no swimmer went."""


def follow_laws(
    terms: Terms, response: ForceResponse, region: Region, noise: float
) -> Proposal | None:
    """Terms whose profiles follow laws; None where the evidence is for none.

    Profiles that leave more than the noise to free kernels are no laws and are not
    tried.
    """
    first = polish(terms, response)
    if first is None or first.noise > POLICY.lawful * noise:
        return None
    best, index = first, 0
    while index < len(best.terms):
        term = best.terms[index]
        if isinstance(term, AbstractProfileTerm) and term.law is None:
            lawful = _with_law_of(best, index, response, region)
            if lawful and lawful.log_evidence > best.log_evidence - KINDS:
                best = lawful
        index += 1
    return None if best is first else simplify(best, response, region)


def _is_lawful(alone: Proposal, index: int, noise: float) -> bool:
    """True if a law alone explains nearly what the kernels of a profile did.

    Rejects laws whose parameters left the region of the data: their forces are rounding
    errors, which explain data to any noise. A ring narrower than its own flank is a
    hill of another formula.
    """
    term = alone.terms[index]
    assert isinstance(term, AbstractProfileTerm)
    law = term.law
    assert law is not None
    constants = law.constants()
    if term.is_odd and constants.get("radius", np.inf) < law.size:
        return False
    return ROUNDED * noise < alone.noise < POLICY.lawful * noise


ROUNDED = 0.5
"""Misfit of a law, relative to that of the kernels, below which it is rounding."""


def _with_law_of(
    structure: Proposal, index: int, response: ForceResponse, region: Region
) -> Proposal | None:
    """The structure in which a profile follows the most likely law.

    A law is polished alone and keeps those numbers. Beside kernels it would not move
    where these carry its misfit, and it would follow errors of the states. It carries
    what is steep, so that the kernels beside it are the coarse ones of a search.
    """
    terms, noise = structure.terms, structure.noise
    before, (term, *after) = terms[:index], terms[index:]
    assert isinstance(term, AbstractProfileTerm)
    is_beside_linear = any(isinstance(one, LinearTerm) for one in terms)
    starts = [
        with_places(term, np.zeros(0), term.width, law)
        for law in _laws_like(term, response, is_beside_linear=is_beside_linear)
    ]
    alone = [polish((*before, start, *after), response) for start in starts]
    good = [one for one in alone if one and _is_lawful(one, index, noise)]
    best = max(good, key=lambda one: one.log_evidence, default=None)
    if best is None:
        return None
    before, (lawful, *after) = best.terms[:index], best.terms[index:]
    assert isinstance(lawful, AbstractProfileTerm)
    places, width = region.distances() if term.is_odd else region.offsets()
    whole = with_places(lawful, np.asarray(places), width)
    terms = (*before, whole, *after)
    beside = polish(terms, response)
    return beside and dataclasses.replace(beside, terms=with_profiles(terms, response))


def _laws_like(
    term: AbstractProfileTerm, response: ForceResponse, *, is_beside_linear: bool
) -> list[FittedLaw]:
    """The laws whose forces come nearest to the profile of a term, of several kinds.

    A linear force beside the term takes any constant and slope of the profile.
    """
    z = np.sort(np.asarray(coordinates(term, response.points)), axis=None)
    z = z[:: -(-len(z) // POINTS)]
    profile = np.asarray(_profile(term, on_device(z)))
    free = np.zeros((len(z), 0))
    if is_beside_linear:
        free = np.stack([z] if term.is_odd else [np.ones_like(z), z], axis=1)
    free = np.linalg.qr(free)[0]
    profile = profile - free @ (free.T @ profile)
    fits = [_nearest(laws, z, profile, free) for laws in _laws(term, z)]
    fits.sort(key=lambda fit: fit[0])
    return [law for _, law in fits[:PROMISING]]


def _nearest(
    laws: FittedLaw,
    z: Float[np.ndarray, " place"],
    profile: Float[np.ndarray, " place"],
    free: Float[np.ndarray, "place direction"],
) -> tuple[float, FittedLaw]:
    """The law of a kind whose force comes nearest to a profile, after its misfit.

    Args:
        free: orthonormal directions that do not count, nor are any in the profile.
    """
    from scipy.optimize import least_squares

    leaves, kind = jax.tree.flatten(laws)
    starts = np.stack([np.asarray(leaf) for leaf in leaves], axis=1)

    def misfits(
        numbers: Float[np.ndarray, "law number"],
    ) -> Float[np.ndarray, "law place"]:
        """Misfits of laws to the profile, each with its best height."""
        stacked = jax.tree.unflatten(kind, list(map(on_device, numbers.T)))
        forces = np.nan_to_num(np.asarray(_law_forces(stacked, on_device(z))))
        forces = forces - (forces @ free) @ free.T
        squares = np.maximum((forces**2).sum(axis=1), np.finfo(float).tiny)
        return profile - ((forces @ profile) / squares)[:, None] * forces

    first = np.argmin((misfits(starts) ** 2).sum(axis=1))
    best = least_squares(lambda one: misfits(one[None])[0], starts[first], max_nfev=50)
    law = jax.tree.unflatten(kind, list(map(on_device, best.x)))
    return float(best.cost), law


@eqx.filter_jit
def _profile(
    term: AbstractProfileTerm, z: Float[Array, " place"]
) -> Float[Array, " place"]:
    return jax.vmap(term.profile)(z)


@eqx.filter_jit
def _law_forces(
    laws: FittedLaw, z: Float[Array, " place"]
) -> Float[Array, "law place"]:
    """Forces of laws of unit height whose numbers are stacked."""
    return jax.vmap(lambda law: jax.vmap(law.force)(z))(laws)


def _laws(
    term: AbstractProfileTerm, z: Float[np.ndarray, " place"]
) -> Iterator[FittedLaw]:
    width = float(term.width)
    shortest = POLICY.shortest * width
    span = Span(z.min(), np.ptp(z), width, shortest, is_distance=term.is_odd)
    geometry = DISTANCES if term.is_odd else LINES
    for name, family in FITTED.items():
        if geometry in family.fitted_in:
            starts = [number.starts(span) for number in family.numbers]
            mesh = np.meshgrid(*starts, indexing="ij")
            numbers = [on_device(one.ravel()) for one in mesh]
            yield jax.vmap(functools.partial(_law, name))(*numbers)


def _law(name: str, *numbers: Scalar) -> FittedLaw:
    return FittedLaw(name, numbers)
