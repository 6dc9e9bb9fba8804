r"""Which two terms explain most of the data together.

A search that adds one term at a time may begin with a term that is in no sum of few: an
ellipse stands for a hill and a wall, and nothing that is added to it leads back. So all
pairs of scanned terms are compared: at a fixed smoothness a profile has few directions,
and the products of all of them with each other are one matrix.
"""

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
    offset = residuals_of_none(response)
    fixed = _directions([beside], beside.prior().start, response)[0]
    blocks = [
        _directions(terms, shape, response)
        for terms, shape in zip(kinds, shapes, strict=True)
    ]
    made = []
    for first, ones in enumerate(blocks):
        for second in range(first, len(blocks)):
            others = blocks[second]
            values = _pair_evidences(fixed, ones, others, offset, response)
            if second == first:
                values = np.where(np.tri(len(ones), dtype=bool), -np.inf, values)
            i, j = np.unravel_index(int(np.argmax(values)), values.shape)
            pair = kinds[first][i], kinds[second][j]
            made.append(ScannedPair(pair, float(values[i, j])))
    return sorted(made, key=lambda one: -one.log_evidence)


def _directions(
    terms: Sequence[AbstractTerm], shape: Shape, response: ForceResponse
) -> Float[np.ndarray, "term datum direction"]:
    """Residuals by the directions of most variance of the weights of each term."""
    columns = root(terms[0].prior().covariance(shape))[:, :DIRECTIONS]
    return reduced_columns(terms, columns, response)


def _pair_evidences(
    fixed: Float[np.ndarray, "datum direction"],
    ones: Float[np.ndarray, "one datum direction"],
    others: Float[np.ndarray, "other datum direction"],
    offset: Float[np.ndarray, " datum"],
    response: ForceResponse,
) -> Float[np.ndarray, "one other"]:
    """Log evidence of each pair, but for a constant."""
    sizes = [fixed.shape[1], ones.shape[2], others.shape[2]]
    ends = np.cumsum([0, *sizes])
    held, left, right = (slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True))
    rows = [np.concatenate(list(block), axis=1) for block in (ones, others)]
    stacked = np.concatenate([fixed, *rows], axis=1)
    gram, along = stacked.T @ stacked, stacked.T @ offset
    starts = [sizes[0], sizes[0] + rows[0].shape[1]]
    squares = float(offset @ offset) + response.squares
    pairs = np.stack(np.mgrid[: len(ones), : len(others)], axis=-1).reshape(-1, 2)
    values = np.empty(len(pairs))
    for begin in range(0, len(pairs), AT_ONCE):
        some = pairs[begin : begin + AT_ONCE]
        places = np.empty((len(some), ends[-1]), int)
        places[:, held] = np.arange(sizes[0])
        places[:, left] = starts[0] + some[:, :1] * sizes[1] + np.arange(sizes[1])
        places[:, right] = starts[1] + some[:, 1:] * sizes[2] + np.arange(sizes[2])
        values[begin : begin + AT_ONCE] = _evidences(
            gram, along, places, squares, response.num_free
        )
    return values.reshape(len(ones), len(others))


def _evidences(
    gram: Float[np.ndarray, "all all"],
    along: Float[np.ndarray, " all"],
    places: Int[np.ndarray, "pair direction"],
    squares: float,
    num_free: int,
) -> Float[np.ndarray, " pair"]:
    """Log evidence of weights at several places, at the best of a few ratios."""
    matrices = gram[places[:, :, None], places[:, None, :]]
    vectors = along[places]
    largest = np.trace(matrices, axis1=1, axis2=2)
    best = np.full(len(places), -np.inf)
    for share in RATIOS:
        ratio = share * largest
        shifted = matrices + ratio[:, None, None] * np.eye(places.shape[1])
        lower = np.linalg.cholesky(shifted)
        whitened = np.linalg.solve(lower, vectors[..., None])[..., 0]
        left = np.maximum(squares - (whitened**2).sum(axis=1), 1e-12 * squares)
        sizes = np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)
        sizes -= 0.5 * places.shape[1] * np.log(ratio)
        best = np.maximum(best, -0.5 * num_free * np.log(left) - sizes)
    return best
