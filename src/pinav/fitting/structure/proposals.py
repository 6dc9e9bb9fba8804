"""Terms with a structure that a force may have, proposed from what the data say of it.

Terms are added (`Candidates`) as long as the evidence of the linearised data
(`ForceResponse`) gains more than their geometry costs.
"""

import itertools
from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np

from pinav.fitting.evidence.model_evidence import DECISIVE
from pinav.fitting.structure.candidates import (
    ENOUGH,
    EXPLAINED,
    HOPELESS,
    PROGRESS,
    Candidates,
)
from pinav.fitting.structure.patterns import lattice_of, with_one_less
from pinav.fitting.structure.response import ForceResponse
from pinav.fitting.structure.starts import Region, circular
from pinav.fitting.structure.trials import Proposal, Terms, polish
from pinav.forces import (
    AbstractTerm,
    EllipticTerm,
    LatticeTerm,
    LinearTerm,
    ObstaclesTerm,
    WallTerm,
)

MOST_TERMS = 3
"""Terms of a structure."""

MOST_ROUNDS = 4
"""Times that a term is added, after some of which an earlier one may go."""

MOST_HALVINGS = 2
"""Times that the width of the kernels of a profile may be halved."""


def propose(
    response: ForceResponse,
    region: Region,
    noise: float,
    *,
    rotational: bool,
    enough: float = ENOUGH,
) -> Proposal | None:
    """The structure of highest evidence; None where no term explains anything.

    Terms are added while data are unexplained, the evidence gains, and the last term
    explained a good part of the rest. Terms that later ones made needless are removed.
    """
    candidates = Candidates.of(response, region, noise, enough)
    best: Proposal | None = None
    may_pair = region.is_planar
    for _ in range(MOST_ROUNDS):
        if best is not None and len(best.terms) == MOST_TERMS:
            break
        terms = () if best is None else best.terms
        trials: list[Proposal] = []
        shaped = [one for one in terms if not isinstance(one, LinearTerm)]
        is_poor = best is not None and best.noise > EXPLAINED * noise
        if may_pair and is_poor and len(shaped) == 1:
            may_pair = False  # what pairs explain does not depend on the terms
            trials = candidates.pair(rotational=rotational)
        least = min((one.noise for one in trials), default=0.0)
        if not candidates.is_enough(trials) and least < HOPELESS * noise:
            trials += candidates.extend(terms, rotational=rotational)
        if not trials:
            break
        most = max(one.log_evidence for one in trials)
        # kinds come in the order of their freedom: a linear force is a wall, too
        winner = next(t for t in trials if t.log_evidence >= most - 2 * DECISIVE)
        winner = candidates.exchange(winner, rotational=rotational)
        before = np.inf if best is None else best.noise
        if best is not None and winner.log_evidence < best.log_evidence + 2 * DECISIVE:
            break
        best = winner
        if best.noise > PROGRESS * before or (
            len(best.terms) == MOST_TERMS and best.noise > HOPELESS * noise
        ):
            break
        if best.noise < EXPLAINED * noise or len(best.terms) == MOST_TERMS:
            best = prune(winner, response)
        if candidates.is_enough([best]):
            break
    return best


def is_hopeless(
    response: ForceResponse, region: Region, noise: float, *, rotational: bool
) -> bool:
    """True if no centre, wall or linear force explains much of the data on its own."""
    candidates = Candidates.of(response, region, noise, HOPELESS)
    return candidates.is_hopeless(candidates.add_term((), rotational=rotational))


def refine(
    proposal: Proposal, response: ForceResponse, halvings: int = MOST_HALVINGS
) -> Proposal:
    """Lay kernels of profiles closer to each other where they are too coarse.

    Kernels coarser than the process span too few profiles, and their band is too
    narrow; finer ones therefore need not gain evidence.
    """
    for _ in range(halvings):
        finer = proposal.finer
        made = None if finer is None else polish(finer, response)
        if made is None or made.log_evidence < proposal.log_evidence - DECISIVE:
            break
        proposal = made
    return proposal


def prune(proposal: Proposal, response: ForceResponse) -> Proposal:
    """Leave out terms and centres that are needless; make circles of ellipses."""
    for fewer in _simpler(proposal.terms):
        made = polish(fewer, response)
        if made and made.log_evidence >= proposal.log_evidence - 2 * DECISIVE:
            return prune(made, response)
    return proposal


def _simpler(terms: Terms) -> Iterator[Terms]:
    """Structures with one term, one centre or one direction less.

    Two plane waves are two walls, too, where data explain no more than those.
    """
    for pair in itertools.combinations(terms, 2):
        for waves in _as_waves(*pair):
            yield (*(one for one in terms if all(one is not t for t in pair)), waves)
    for index, term in enumerate(terms):
        before, after = terms[:index], terms[index + 1 :]
        if len(terms) > 1:
            yield before + after
        if isinstance(term, EllipticTerm):
            yield (*before, circular(term, term.center), *after)
        if isinstance(term, ObstaclesTerm):
            yield from ((*before, fewer, *after) for fewer in with_one_less(term))


def fallbacks(terms: Terms) -> Iterator[Terms]:
    """Structures to fit in place of one that no fit carries.

    One centre in place of obstacles, which errors of the smoothed states about it may
    suggest; or all terms but the one added last.
    """
    for index, term in enumerate(terms):
        if isinstance(term, ObstaclesTerm):
            single = circular(term, jnp.mean(term.centers, axis=0))
            yield (*terms[:index], single, *terms[index + 1 :])
    if len(terms) > 1:
        yield terms[:-1]


def _as_waves(first: AbstractTerm, second: AbstractTerm) -> list[LatticeTerm]:
    """Two walls as a lattice; nothing where they could not be."""
    if not (isinstance(first, WallTerm) and isinstance(second, WallTerm)):
        return []
    return [lattice_of(first, second)] if first.rotational == second.rotational else []
