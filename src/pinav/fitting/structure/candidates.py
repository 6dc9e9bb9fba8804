"""Structures that may explain more of the data than a given one does.

Each kind of term is scanned on a grid of its geometry, then on finer ones about the
best, beside the terms that there are; what explains most is polished.
"""

from collections.abc import Iterator, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.fitting.evidence.model_evidence import DECISIVE
from pinav.fitting.structure.patterns import (
    PotentialMap,
    lattices,
    obstacles,
    scan_pairs,
    twins,
)
from pinav.fitting.structure.response import ForceResponse
from pinav.fitting.structure.starts import (
    ANGLES,
    GRID,
    Region,
    ellipses,
    linear_term,
    scanned_terms,
    segments,
    turned_shears,
)
from pinav.fitting.structure.trials import (
    Proposal,
    Terms,
    polish,
    quick_evidences,
    smooth_shape,
)
from pinav.forces import (
    AbstractTerm,
    CentralTerm,
    EllipticTerm,
    LinearTerm,
    ObstaclesTerm,
    WallTerm,
)

CLOSER = {2: (7, (0.3, 0.1)), 3: (3, (0.25, 0.12, 0.06))}
"""Places along each side of further grids of centres, and their sizes, each about the
best of those before; by the dimension of space."""

FINER_ANGLES = (0.8, 0.16)
"""Sizes of further grids of directions about the best one, relative to the distance of
those that are scanned first, to either side."""

EXPLAINED = 1.7
"""Misfit of a proposal, relative to the noise, above which it is not fitted: its free
remainder would have to carry too much."""

HOPELESS = 5.0
"""Misfit of as many terms as there may be, relative to the noise, at which the search
ends: none of them is worth leaving out for another."""

PROMISING, PAIRS, FIRST_PAIRS = 3, 6, 2
"""Kinds, and pairs of kinds, that are polished, of those that were scanned; and pairs
after which the others are not, where those are hopeless."""

MOST_GROWN, ALIKE = 5, 1.5
"""Obstacles of one kind to which a pair of them grows; needless ones go later. And the
misfit of a pair relative to the least of any, above which it does not grow."""

MOST_WALLS = 2
"""Walls of pairs beside which an ellipse is sought anywhere, which takes long."""

AGAIN = 3
"""Times that the polish of several terms is repeated at most."""

ENOUGH, PROGRESS = 1.4, 0.8
"""Misfit, relative to the noise, at which nothing is left to explain; and relative to
the misfit before, above which further terms lead nowhere."""


class Candidates(eqx.Module):
    """Structures that may explain more of some data.

    Attributes:
        enough: misfit relative to the noise at which nothing else is sought.
        seen: the potential of free kernels, in the plane.
        summits: of that potential, further places of centres [L].
    """

    response: ForceResponse
    region: Region
    noise: float
    enough: float
    seen: PotentialMap | None
    summits: Float[np.ndarray, "place dim"]

    @classmethod
    def of(
        cls, response: ForceResponse, region: Region, noise: float, enough: float
    ) -> "Candidates":
        """Those of the data, with the summits of their free potential."""
        seen = PotentialMap.of(response) if region.is_planar else None
        summits = np.zeros((0, len(region.middle))) if seen is None else seen.summits()
        return cls(response, region, noise, enough, seen, summits)

    def add_term(self, terms: Terms, *, rotational: bool) -> list[Proposal]:
        """Structures with one scanned term more than there are, polished.

        A linear force is added beside the first: swimmers that are flung out need it.
        """
        linear, *kinds = scanned_terms(self.region, self.summits, rotational=rotational)
        beside = terms or tuple(linear)
        scanned = [self._scan(starts, beside) for starts in kinds]
        scanned += self._with_twins(terms)
        least = sorted(one.log_evidence for one in scanned)[-PROMISING:][0]
        best = [one.terms for one in scanned if one.log_evidence >= least]
        if not any(isinstance(one, LinearTerm) and not one.rotational for one in terms):
            best = [(*terms, *linear), *best]
        return self._polish_each(best)

    def extend(self, terms: Terms, *, rotational: bool) -> list[Proposal]:
        """Structures with one term more than there are, of each kind, polished."""
        proposals = self.add_term(terms, rotational=rotational)
        if self.seen is None or self.is_enough(proposals):
            return proposals
        beside = terms or (linear_term(self.region),)
        fitted = [one.terms[-1] for one in proposals]
        for ellipse in self._ellipses(beside, fitted):
            proposals += self._polish_each([ellipse])
            if self.is_enough(proposals):
                return proposals
        if terms:
            return proposals
        peaks = [self._move_each(one) for one in obstacles(self.seen, self.region)]
        lattice = self._best(lattices(self.region), ()).terms
        patterns = self._polish_each([lattice, *((one,) for one in peaks)])
        # of a sum that is not explained yet a pattern is a poor beginning
        return proposals + [
            one for one in patterns if one.noise < EXPLAINED * self.noise
        ]

    def pair(self, *, rotational: bool) -> list[Proposal]:
        """Structures of the two terms that explain most together, polished."""
        (linear, *_), *kinds = scanned_terms(
            self.region, self.summits, rotational=rotational
        )
        profiles: list[Sequence[AbstractTerm]] = [
            one for one in kinds if not isinstance(one[0], LinearTerm)
        ]
        if len(self.summits):
            profiles.append(ellipses(self.region, self.summits, turned_shears()))
        shapes = [smooth_shape(one[0], self.response) for one in profiles]
        pairs = scan_pairs(profiles, shapes, linear, self.response)
        proposals: list[Proposal] = []
        alike: list[ObstaclesTerm] = []
        for rank, pair in enumerate(pairs[:PAIRS]):
            if rank >= FIRST_PAIRS and self.is_hopeless(proposals):
                break
            terms = (linear, *pair.terms)
            for _ in pair.terms:  # each beside the other, on finer grids
                terms = self._scan([terms[1]], (linear, *terms[2:])).terms
            several = _as_one_kind(*terms[1:])
            alike += several
            made = [*((linear, one) for one in several), terms]
            proposals += self._polish_each(made, AGAIN)
            if self.is_enough(proposals):
                return proposals
        least = min((one.noise for one in proposals), default=0.0)
        if any(
            isinstance(one.terms[-1], ObstaclesTerm) and one.noise < ALIKE * least
            for one in proposals
        ):
            # from where they were scanned: polished, two have moved to stand for others
            grown = [(linear, self._grow(one, linear)) for one in alike]
            proposals += self._polish_each(grown, AGAIN)
            if self.is_enough(proposals):
                return proposals
        if self.is_hopeless(proposals):
            return proposals
        for terms in self.beside_walls(proposals, linear):
            proposals += self._polish_each([terms], AGAIN)
            if self.is_enough(proposals):
                break
        return proposals

    def beside_walls(
        self, proposals: Sequence[Proposal], linear: AbstractTerm
    ) -> Iterator[Terms]:
        """Structures with an ellipse anywhere beside the walls of the best pairs.

        The wall may be the only right term of a pair.
        """
        places = np.concatenate([self.region.grid(GRID[2]), self.summits])
        starts = ellipses(self.region, places, turned_shears())
        best = sorted(proposals, key=lambda one: one.noise)
        tried: list[float] = []
        for wall in (term for proposal in best for term in proposal.terms):
            if not isinstance(wall, WallTerm) or wall.rotational:
                continue
            angle = float(wall.angle)
            turns = np.abs(np.sin(angle - np.asarray(tried)))
            if (turns > np.sin(0.5 * np.pi / ANGLES)).all():
                tried.append(angle)
                yield self._scan(starts, (linear, wall)).terms
            if len(tried) == MOST_WALLS:
                return

    def _ellipses(
        self, terms: Terms, fitted: Sequence[AbstractTerm]
    ) -> Iterator[Terms]:
        """Structures with one more ellipse, about the most likely summits.

        The one that is scanned moves towards whatever its wrong axes explain best. So
        those about single summits are polished from there, too. A long one explains
        little unless its direction and place are right: it is a segment of a wall.
        """
        turned = turned_shears()
        starts = [ellipses(self.region, place[None], turned) for place in self.summits]
        scanned = [self._best(about, terms) for about in starts]
        scanned.sort(key=lambda one: one.log_evidence, reverse=True)
        likely = [one.terms[-1] for one in scanned[:1]]
        walls = (one for one in fitted if isinstance(one, WallTerm))
        long = [one for wall in walls for one in segments(self.region, wall)]
        for starts in (likely, long):
            if starts:
                yield self._scan(starts, terms).terms
        yield from (one.terms for one in scanned[:PROMISING])

    def exchange(self, proposal: Proposal, *, rotational: bool) -> Proposal:
        """The structure with earlier terms exchanged for others that explain more.

        The first of several terms also fits what the later ones explain: one ellipse
        may stand for a hill and a wall.
        """
        is_enough = self.is_enough([proposal])
        for index, term in enumerate(proposal.terms[:-1]):
            simpler = isinstance(term, EllipticTerm)
            if isinstance(term, LinearTerm) or (is_enough and not simpler):
                continue
            rest = proposal.terms[:index] + proposal.terms[index + 1 :]
            _, *kinds = scanned_terms(self.region, self.summits, rotational=rotational)
            others = [self._scan(starts, rest) for starts in kinds]
            likely = max(others, key=lambda one: one.log_evidence)
            for other in self._polish_each([likely.terms], AGAIN):
                gain = other.log_evidence - proposal.log_evidence
                if gain <= (-2 if simpler else 2) * DECISIVE:
                    continue
                if not simpler and other.noise > PROGRESS * proposal.noise:
                    return other
                return self.exchange(other, rotational=rotational)
        return proposal

    def _with_twins(self, terms: Terms) -> "list[_Scanned]":
        """Structures in which a centre of force has another one of its kind."""
        made: list[_Scanned] = []
        for index, term in enumerate(terms):
            if isinstance(term, CentralTerm | ObstaclesTerm):
                rest = terms[:index] + terms[index + 1 :]
                made.append(self._scan(twins(term, self._places), rest))
        return made

    @property
    def _places(self) -> Float[np.ndarray, "place dim"]:
        return np.concatenate([self.region.places(), self.summits])

    def is_enough(self, proposals: Sequence[Proposal]) -> bool:
        """True if one of them leaves so little that nothing else is sought."""
        return any(one.noise < self.enough * self.noise for one in proposals)

    def is_hopeless(self, proposals: Sequence[Proposal]) -> bool:
        """True if each of them leaves so much that none like them is sought."""
        return all(one.noise > HOPELESS * self.noise for one in proposals)

    def _polish_each(
        self, structures: Sequence[Terms], again: int = 1
    ) -> list[Proposal]:
        """Proposals, polished, and again where that may explain more."""
        between = ENOUGH * self.noise, HOPELESS * self.noise
        made = [
            polish(terms, self.response, again=again, between=between)
            for terms in structures
        ]
        return [one for one in made if one is not None]

    def _scan(self, starts: Sequence[AbstractTerm], terms: Terms) -> "_Scanned":
        """The best term of a kind beside others; its geometry on ever finer grids."""
        best = self._best(starts, terms)
        for step in FINER_ANGLES:
            wall = best.terms[-1]
            if not isinstance(wall, WallTerm):
                break
            angles = wall.angle + step * np.pi / ANGLES * jnp.linspace(-1, 1, 9)
            closer = [eqx.tree_at(lambda one: one.angle, wall, x) for x in angles]
            best = self._best(closer, terms)
        side, fractions = CLOSER[len(self.region.middle)]
        for fraction in fractions:
            chosen = best.terms[-1]
            if not isinstance(chosen, Centered):
                break
            places = self.region.grid(side, _last_center(chosen), fraction)
            closer = [_move(chosen, place) for place in places]
            best = self._best([chosen, *closer], terms)
        return best

    def _grow(self, term: ObstaclesTerm, linear: AbstractTerm) -> ObstaclesTerm:
        """Obstacles with as many more of their kind as explain more, then moved."""
        best, reached = term, self._best([term], (linear,)).log_evidence
        while len(best.centers) < MOST_GROWN:
            scanned = self._scan(twins(best, self._places), (linear,))
            if scanned.log_evidence < reached + 2 * DECISIVE:
                break
            moved = self._move_each(scanned.terms[-1], (linear,))
            best, reached = moved, self._best([moved], (linear,)).log_evidence
        return best

    def _move_each(self, term: AbstractTerm, beside: Terms = ()) -> ObstaclesTerm:
        """Obstacles with each centre in turn moved to where it explains most."""
        assert isinstance(term, ObstaclesTerm)
        for _ in term.centers:
            # the last centre is the one that a scan moves
            turned = jnp.roll(term.centers, 1, axis=0)
            start = eqx.tree_at(lambda one: one.centers, term, turned)
            term = self._scan([start], beside).terms[-1]
            assert isinstance(term, ObstaclesTerm)
        return term

    def _best(self, starts: Sequence[AbstractTerm], terms: Terms) -> "_Scanned":
        values = quick_evidences(starts, terms, self.response)
        index = int(np.argmax(values))
        return _Scanned((*terms, starts[index]), values[index])


class _Scanned(eqx.Module):
    terms: Terms
    log_evidence: float


def _as_one_kind(first: AbstractTerm, second: AbstractTerm) -> list[ObstaclesTerm]:
    """Two centres as obstacles of one kind; nothing where they could not be."""
    if not (isinstance(first, CentralTerm) and isinstance(second, CentralTerm)):
        return []
    is_alike = first.rotational == second.rotational
    return twins(first, np.asarray(second.center)[None]) if is_alike else []


Centered = CentralTerm | EllipticTerm | ObstaclesTerm


def _last_center(term: Centered) -> Float[np.ndarray, " dim"]:
    if isinstance(term, ObstaclesTerm):
        return np.asarray(term.centers[-1])
    return np.asarray(term.center)


def _move(term: Centered, center: Float[np.ndarray, " dim"]) -> Centered:
    if isinstance(term, ObstaclesTerm):
        moved = term.centers.at[-1].set(jnp.asarray(center))
        return eqx.tree_at(lambda one: one.centers, term, moved)
    return eqx.tree_at(lambda one: one.center, term, jnp.asarray(center))
