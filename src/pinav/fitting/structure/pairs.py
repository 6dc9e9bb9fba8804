r"""Which two terms explain most of the data together.

A search that adds one term at a time may begin with a term that is in no sum of few: an
ellipse stands for a hill and a wall, and nothing that is added to it leads back. So all
pairs of scanned terms are compared: at a fixed smoothness a profile has few directions,
and the products of all of them with each other are one matrix.
"""

import itertools
from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from pinav.fitting.evidence.evidence import root
from pinav.fitting.structure.response import (
    ForceResponse,
    term_columns,
)
from pinav.forces import AbstractTerm
from pinav.forces.priors import Shape

DIRECTIONS = 24
"""Directions of a profile that count, at most."""

RATIOS = (1e-4, 1e-6, 1e-8)
"""Variances of the noise that are tried, relative to the largest of the force."""

ROUNDING = 1e-12
"""Share of the squares that are rounding."""

AT_ONCE = 2000
"""Pairs whose evidence is computed in one call."""


class ScannedPair(eqx.Module):
    """The best pair of two kinds.

    Attributes:
        terms: both.
        log_evidence: at the best of a few amplitudes.
    """

    terms: tuple[AbstractTerm, AbstractTerm]
    log_evidence: float


def scan_pairs(
    kinds: Sequence[Sequence[AbstractTerm]],
    shapes: Sequence[Shape],
    beside: AbstractTerm,
    response: ForceResponse,
) -> list[ScannedPair]:
    """The best pair of each two kinds, that of highest evidence first.

    Args:
        kinds: terms of each kind, of several geometries.
        shapes: of the prior of each kind.
        beside: a term that is there in any case.
        response: of the data to forces.
    """
    blocks = [
        _directions([beside], beside.prior().start, response),
        *(
            _directions(terms, s, response)
            for terms, s in zip(kinds, shapes, strict=True)
        ),
    ]
    products = _Products.of(blocks, response)
    made = []
    for first, second in itertools.combinations_with_replacement(range(len(kinds)), 2):
        values = products.evidences(first, second)
        if second == first:  # each pair once, and no term beside itself
            values[np.tri(len(values), dtype=bool)] = -np.inf
        best = int(np.argmax(values))
        i, j = divmod(best, values.shape[1])
        pair = kinds[first][i], kinds[second][j]
        made.append(ScannedPair(pair, float(values.flat[best])))
    return sorted(made, key=lambda one: -one.log_evidence)


def _directions(
    terms: Sequence[AbstractTerm], shape: Shape, response: ForceResponse
) -> Float[np.ndarray, "term datum direction"]:
    """Residuals by the directions of most variance of the weights of each term."""
    chosen = root(terms[0].prior().covariance(shape))[:, :DIRECTIONS]
    return np.stack([rows @ chosen for rows in term_columns(terms, response)])


class _Products(eqx.Module):
    """Products of all directions of all terms with each other.

    Attributes:
        gram: of the directions with each other.
        along: of the directions with the residuals of no force.
        places: of the directions of each term of each kind; those of the term that is
            there in any case come first.
        squares: sum of squares where there is no force.
        num_free: residuals less starts.
    """

    gram: Float[np.ndarray, "all all"]
    along: Float[np.ndarray, " all"]
    places: list[Int[np.ndarray, "_ _"]]
    squares: float
    num_free: int

    @classmethod
    def of(
        cls,
        blocks: Sequence[Float[np.ndarray, "_ datum _"]],
        response: ForceResponse,
    ) -> "_Products":
        stacked = np.concatenate([side for block in blocks for side in block], axis=1)
        sizes = [block.shape[0] * block.shape[2] for block in blocks]
        places = np.split(np.arange(sum(sizes)), np.cumsum(sizes)[:-1])
        offset = response.residuals_of_none
        return cls(
            gram=stacked.T @ stacked,
            along=stacked.T @ offset,
            places=[p.reshape(len(b), -1) for p, b in zip(places, blocks, strict=True)],
            squares=float(offset @ offset) + response.squares,
            num_free=response.num_free,
        )

    def evidences(self, one: int, other: int) -> Float[np.ndarray, "one other"]:
        """Log evidence of each of one kind beside each of another."""
        (fixed,), *kinds = self.places
        first, second = kinds[one], kinds[other]
        pairs = np.argwhere(np.ones((len(first), len(second)), bool))
        held = np.broadcast_to(fixed, (len(pairs), len(fixed)))
        sides = held, first[pairs[:, 0]], second[pairs[:, 1]]
        places = np.concatenate(sides, axis=1)
        parts = [
            self._evidences(places[begin : begin + AT_ONCE])
            for begin in range(0, len(places), AT_ONCE)
        ]
        return np.concatenate(parts).reshape(len(first), len(second))

    def _evidences(
        self, places: Int[np.ndarray, "pair direction"]
    ) -> Float[np.ndarray, " pair"]:
        """Log evidence of weights at several places, at the best of a few ratios."""
        matrices = self.gram[places[:, :, None], places[:, None, :]]
        vectors, count = self.along[places], places.shape[1]
        largest = np.trace(matrices, axis1=1, axis2=2)
        best = np.full(len(places), -np.inf)
        for share in RATIOS:
            ratio = share * largest
            lower = np.linalg.cholesky(matrices + ratio[:, None, None] * np.eye(count))
            whitened = np.linalg.solve(lower, vectors[..., None])[..., 0]
            left = self.squares - (whitened**2).sum(axis=1)
            left = np.maximum(left, ROUNDING * self.squares)
            sizes = np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)
            values = -0.5 * (self.num_free * np.log(left) - count * np.log(ratio))
            best = np.maximum(best, values - sizes)
        return best
