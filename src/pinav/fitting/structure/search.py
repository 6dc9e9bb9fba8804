"""The search for terms in one linearisation of the data.

Scan all kinds of terms at all their places (`Held`), move the most likely ones to where
they explain most (`move`), polish them, and compare what they explain by its evidence.
A stage is never left before all of it was compared: terms that are good enough are not
always the right ones.
"""

import functools
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.fitting.policy import POLICY
from pinav.fitting.structure.kinds import (
    has_shape,
    lattices,
    signature,
    simple_kinds,
    simpler,
    turned_shears,
)
from pinav.fitting.structure.moves import move
from pinav.fitting.structure.potential_map import PotentialMap
from pinav.fitting.structure.response import ForceResponse
from pinav.fitting.structure.scan import Atoms, Held
from pinav.fitting.structure.starts import Region, ellipses, linear_term, obstacles_at
from pinav.fitting.structure.trace import Trace
from pinav.fitting.structure.trials import Proposal, Terms, polish
from pinav.forces import AbstractTerm, CentralTerm, EllipticTerm, LinearTerm, WallTerm


class Trial(NamedTuple):
    """Terms that were scanned, not polished yet, and their quick evidence [nats]."""

    log_evidence: float
    terms: Terms


Tried = TypeVar("Tried", Trial, Proposal)


class Search(eqx.Module):
    """Terms that may explain some data.

    Attributes:
        noise: standard deviation of the observations [L].
        rotational: include terms that turn.
        content: misfit at which no further stage is searched,
        least: where the evidence is not below this [nats].
    """

    response: ForceResponse
    region: Region
    noise: float
    rotational: bool
    content: float = POLICY.content
    least: float = -np.inf
    trace: Trace = eqx.field(static=True, default_factory=Trace)

    def run(self, *, singles_only: bool = False) -> list[Proposal]:
        """Proposals of different kinds, those preferred by the evidence first."""
        proposals = list(self._singles)
        for stage in () if singles_only else (self._sums, self._beside_best):
            best = preferred(proposals)[:1]
            if any(map(self._is_content, best)) or self.trace.is_over:
                break
            proposals += self._polished(list(stage(proposals)))
        return preferred(proposals)

    @functools.cached_property
    def _dictionary(self) -> "_Dictionary":
        return _Dictionary.of(self)

    @functools.cached_property
    def _singles(self) -> list[Proposal]:
        linear = self._polished([Trial(0.0, (self._dictionary.linear,))])
        return linear + self._polished(list(self._dictionary.singles()))

    def _sums(self, _: Sequence[Proposal]) -> Iterator[Trial]:
        return self._dictionary.sums()

    def _beside_best(self, proposals: Sequence[Proposal]) -> Iterator[Trial]:
        for one in preferred(proposals)[: POLICY.parents]:
            yield from self._dictionary.beside(one.terms)

    def _is_content(self, proposal: Proposal) -> bool:
        is_likely = proposal.log_evidence > self.least
        return is_likely and proposal.noise < self.content * self.noise

    def _note(self, terms: Terms, made: Proposal | None, ended: str) -> None:
        numbers = () if made is None else (made.log_evidence, made.noise / self.noise)
        self.trace.note(terms, ended, *numbers)

    def _polished(self, trials: Sequence[Trial]) -> list[Proposal]:
        """The most likely trials, at most two of the same kinds, moved and polished."""
        likely: list[Trial] = []
        for trial in _by_evidence(trials):
            kinds = signature(trial.terms)
            if sum(signature(one.terms) == kinds for one in likely) < 2:
                likely.append(trial)
        placed = [move(trial.terms, self.response) for trial in likely[: POLICY.moved]]
        likely = _unlike([Trial(one.log_evidence, one.terms) for one in placed])
        made: list[Proposal] = []
        for trial in _by_evidence(likely)[: POLICY.polished]:
            if made and self.trace.is_over:
                self.trace.note(trial.terms, "scanned; the budget was spent")
                continue
            proposal = polish(trial.terms, self.response)
            ended = "polished" if proposal else "has no optimum"
            self._note(trial.terms, proposal, ended)
            if proposal is not None:
                made.append(proposal)
        return made


class _Dictionary(eqx.Module):
    """All terms that are scanned, with their columns."""

    simple: list[Atoms]
    linear: LinearTerm
    held: Held
    region: Region
    response: ForceResponse
    summits: Float[np.ndarray, "place dim"]

    @classmethod
    def of(cls, search: Search) -> "_Dictionary":
        region, response = search.region, search.response
        seen = PotentialMap.of(response) if region.is_planar else None
        summits = np.zeros((0, len(region.middle))) if seen is None else seen.summits()
        places = np.concatenate([region.places(), summits])
        kinds = simple_kinds(region, places, rotational=search.rotational)
        simple = [Atoms.of(terms, response) for terms in kinds]
        linear = linear_term(region)
        held = Held.of((linear,), response)
        return cls(simple, linear, held, region, response, summits)

    def singles(self) -> Iterator[Trial]:
        """One term of each simple kind beside the linear force."""
        for atoms in self.simple:
            if has_shape(atoms.terms[0]):
                yield from self._best_few(atoms)

    def sums(self) -> Iterator[Trial]:
        """Obstacles of one kind, ellipses, lattices, and all pairs of terms."""
        kinds = [
            atoms
            for atoms in self.scanned
            if not isinstance(atoms.terms[0], EllipticTerm)
        ]
        for atoms in kinds:
            first = atoms.terms[0]
            if isinstance(first, CentralTerm):
                value, chosen = self.held.set_of_one_profile(atoms)
                centers = jnp.asarray(_centers(atoms)[chosen])
                yield Trial(value, (self.linear, obstacles_at(first, centers)))
        if self.region.is_planar:
            yield from self._planar()
        if len(self.summits):
            last = POLICY.turns * len(self.summits)
            kinds.append(self.scanned[-len(POLICY.shears)][-last:])
        for index, first in enumerate(kinds):
            for second in kinds[index:]:
                yield from self._best_pair(first, second)

    def beside(self, terms: Terms) -> Iterator[Trial]:
        """The terms with one more, or with another in the place of one.

        Of a sum of three the best pair may be no part, but what is missing beside it
        then is; what the sum does not need goes when it is simplified.
        """
        for index in range(len(terms) + 1):
            rest = terms[:index] + terms[index + 1 :]
            if index < len(terms) and not has_shape(terms[index]):
                continue
            held = Held.of(rest, self.response)
            for atoms in self.scanned:
                values = held.beside(atoms)
                best = int(np.argmax(values))
                yield Trial(float(values[best]), (*rest, atoms.terms[best]))

    @functools.cached_property
    def scanned(self) -> list[Atoms]:
        """All kinds of single terms with a shape, the lattices and ellipses last."""
        shaped = [atoms for atoms in self.simple if has_shape(atoms.terms[0])]
        if not self.region.is_planar:
            return shaped
        dense = self.region.dense_places(POLICY.dense)
        places = np.concatenate([dense, self.summits])
        kinds: list[Sequence[AbstractTerm]] = [lattices(self.region)]
        for size in POLICY.shears:
            kinds.append(ellipses(self.region, places, turned_shears(size)))
        return shaped + [Atoms.of(terms, self.response) for terms in kinds]

    def _planar(self) -> Iterator[Trial]:
        """Lattices and ellipses, which are tried everywhere, also beside walls."""
        waves, *ellipses = self.scanned[-1 - len(POLICY.shears) :]
        yield from self._best_few(waves)
        for atoms in ellipses:
            yield from self._best_few(atoms)
            for walls in self.simple:
                if isinstance(walls.terms[0], WallTerm):
                    yield from self._best_pair(walls, atoms)

    def _best_few(self, atoms: Atoms) -> Iterator[Trial]:
        """The most likely term of a kind, and the most likely one elsewhere."""
        values = self.held.beside(atoms)
        best = int(np.argmax(values))
        yield Trial(float(values[best]), (self.linear, atoms.terms[best]))
        if isinstance(atoms.terms[0], CentralTerm | EllipticTerm):
            centers = _centers(atoms)
            gaps = np.linalg.norm(centers - centers[best], axis=1)
            values = np.where(gaps > 0.2 * self.region.core_extent, values, -np.inf)
            other = int(np.argmax(values))
            yield Trial(float(values[other]), (self.linear, atoms.terms[other]))

    def _best_pair(self, first: Atoms, second: Atoms) -> Iterator[Trial]:
        values = self.held.pairs(first, second)
        i, j = divmod(int(np.argmax(values)), values.shape[1])
        if np.isfinite(values[i, j]):
            terms = self.linear, first.terms[i], second.terms[j]
            yield Trial(float(values[i, j]), terms)


def _by_evidence(tried: Sequence[Tried]) -> list[Tried]:
    return sorted(tried, key=lambda one: -one.log_evidence)


def _unlike(trials: Sequence[Trial]) -> list[Trial]:
    """Trials of which none has the kinds and the evidence of one before."""
    kept: list[Trial] = []
    for one in trials:
        if not any(
            signature(one.terms) == signature(other.terms)
            and abs(one.log_evidence - other.log_evidence) < 1.0
            for other in kept
        ):
            kept.append(one)
    return kept


def _centers(atoms: Atoms) -> Float[np.ndarray, "atom dim"]:
    terms: Sequence[Any] = atoms.terms
    return np.stack([np.asarray(term.center) for term in terms])


def preferred(proposals: Sequence[Proposal]) -> list[Proposal]:
    """Proposals of different kinds by their evidence, the preferred one first.

    Where the evidence hardly tells, the one that came first is preferred: kinds come in
    the order of their freedom, and a linear force is a wall, too.
    """
    most = max((one.log_evidence for one in proposals), default=-np.inf)
    near = [one for one in proposals if one.log_evidence >= most - 2 * POLICY.decisive]
    kept: dict[tuple[str, ...], Proposal] = {}
    for one in (*near[:1], *_by_evidence(proposals)):
        kept.setdefault(signature(one.terms), one)
    return list(kept.values())


def simplify(proposal: Proposal, response: ForceResponse, region: Region) -> Proposal:
    """The structure without terms and centres that the evidence does not ask for."""
    for fewer in simpler(proposal.terms, region):
        made = polish(fewer, response)
        if made and made.log_evidence >= proposal.log_evidence - 2 * POLICY.decisive:
            return simplify(made, response, region)
    return proposal


def refine(
    proposal: Proposal, response: ForceResponse, halvings: int = POLICY.halvings
) -> Proposal:
    """Lay kernels of profiles closer to each other where they are too coarse.

    Kernels coarser than the process span too few profiles, and their band is too
    narrow; finer ones therefore need not gain evidence.
    """
    for _ in range(halvings):
        finer = proposal.finer
        made = None if finer is None else polish(finer, response)
        if made is None or made.log_evidence < proposal.log_evidence - POLICY.decisive:
            break
        proposal = made
    return proposal
