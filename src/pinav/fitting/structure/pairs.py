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
    reduced_columns,
    residuals_of_none,
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
    grounds = _Grounds(
        offset=residuals_of_none(response),
        fixed=_directions([beside], beside.prior().start, response)[0],
        squares=response.squares,
        num_free=response.num_free,
    )
    blocks = [
        _directions(terms, shape, response)
        for terms, shape in zip(kinds, shapes, strict=True)
    ]
    made = []
    for first, second in itertools.combinations_with_replacement(range(len(kinds)), 2):
        values = grounds.evidences(blocks[first], blocks[second])
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
    columns = root(terms[0].prior().covariance(shape))[:, :DIRECTIONS]
    return reduced_columns(terms, columns, response)


class _Grounds(eqx.Module):
    """What is the same for all pairs.

    Attributes:
        offset: residuals of no force.
        fixed: residuals by the directions of a term that is there in any case.
        squares: sum of squares that no force explains.
        num_free: residuals less starts.
    """

    offset: Float[np.ndarray, " datum"]
    fixed: Float[np.ndarray, "datum direction"]
    squares: float
    num_free: int

    def evidences(
        self,
        ones: Float[np.ndarray, "one datum direction"],
        others: Float[np.ndarray, "other datum direction"],
    ) -> Float[np.ndarray, "one other"]:
        """Log evidence of each of one kind beside each of another."""
        sides = [np.concatenate(list(block), axis=1) for block in (ones, others)]
        stacked = np.concatenate([self.fixed, *sides], axis=1)
        gram, along = stacked.T @ stacked, stacked.T @ self.offset
        count, left, right = self.fixed.shape[1], ones.shape[2], others.shape[2]
        pairs = np.argwhere(np.ones((len(ones), len(others)), bool))
        first = count + pairs[:, :1] * left + np.arange(left)
        second = count + len(ones) * left + pairs[:, 1:] * right + np.arange(right)
        held = np.broadcast_to(np.arange(count), (len(pairs), count))
        places = np.concatenate([held, first, second], axis=1)
        parts = [
            self._evidences(gram, along, places[begin : begin + AT_ONCE])
            for begin in range(0, len(places), AT_ONCE)
        ]
        return np.concatenate(parts).reshape(len(ones), len(others))

    def _evidences(
        self,
        gram: Float[np.ndarray, "all all"],
        along: Float[np.ndarray, " all"],
        places: Int[np.ndarray, "pair direction"],
    ) -> Float[np.ndarray, " pair"]:
        """Log evidence of weights at several places, at the best of a few ratios."""
        matrices = gram[places[:, :, None], places[:, None, :]]
        vectors, count = along[places], places.shape[1]
        largest = np.trace(matrices, axis1=1, axis2=2)
        squares = float(self.offset @ self.offset) + self.squares
        best = np.full(len(places), -np.inf)
        for share in RATIOS:
            ratio = share * largest
            lower = np.linalg.cholesky(matrices + ratio[:, None, None] * np.eye(count))
            whitened = np.linalg.solve(lower, vectors[..., None])[..., 0]
            left = np.maximum(squares - (whitened**2).sum(axis=1), ROUNDING * squares)
            sizes = np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)
            values = -0.5 * (self.num_free * np.log(left) - count * np.log(ratio))
            best = np.maximum(best, values - sizes)
        return best
