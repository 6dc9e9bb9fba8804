r"""Terms moved to where they explain more, at a fixed smoothness of their profiles.

With columns $X$ of the weights, in the prior's own directions and scaled as in a scan,
and the slopes $J$ of the residuals by the geometry of all terms, a step solves

$$\min_{u, \delta} |r + X u + J \delta|^2 + \beta |u|^2
  + \lambda \sum_k |J_k|^2 \delta_k^2.$$

Weights follow each geometry, so that $r + X u$ is what the best of them leave. It is
the variable projection of Kaufman (BIT 15, 49, 1975) with the damping of Marquardt.
"""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
import scipy.linalg
from jaxtyping import Float

from pinav.arguments import on_device
from pinav.fitting.engine.local_model import ravel_model
from pinav.fitting.evidence.evidence import root
from pinav.fitting.policy import POLICY
from pinav.fitting.structure.response import ForceResponse, slopes
from pinav.fitting.structure.scan import ROUNDING
from pinav.fitting.structure.trials import Terms, cost, scanned_shapes
from pinav.forces import AbstractTerm

Roots = Sequence[Float[np.ndarray, "_ _"]]
"""Roots of the prior covariance of the weights of each term."""


class Placed(eqx.Module):
    """Terms with the weights that explain most, at a fixed smoothness.

    Attributes:
        log_evidence: quick evidence, with the cost of the geometry [nats].
        ratio: variance of the noise relative to that of a direction of the weights.
        columns: what the data see of each direction of the weights.
        weights: amplitude of each direction.
        left: residuals that the terms leave.
    """

    terms: Terms
    log_evidence: float
    ratio: float
    columns: Float[np.ndarray, "datum direction"]
    weights: Float[np.ndarray, " direction"]
    left: Float[np.ndarray, " datum"]

    @classmethod
    def of(cls, terms: Terms, roots: Roots, response: ForceResponse) -> "Placed":
        """The terms with their best weights."""
        scaled, columns = [], []
        for term, directions in zip(terms, roots, strict=True):
            rows = slopes(term, response)[:, : term.weights.size] @ directions
            size = max(float(np.sqrt((rows**2).sum())), np.finfo(float).tiny)
            columns.append(rows / size)
            scaled.append(directions / size)
        x, offset = np.concatenate(columns, axis=1), response.residuals_of_none
        values, vectors = np.linalg.eigh(x.T @ x)
        values = np.maximum(values, 0.0)
        along = vectors.T @ (x.T @ offset)
        squares = float(offset @ offset) + response.squares
        ratios = np.asarray(POLICY.ratios)[:, None]
        left = squares - (along**2 / (values + ratios)).sum(axis=1)
        left = np.maximum(left, ROUNDING * squares)
        evidence = -0.5 * response.num_free * np.log(left)
        evidence -= 0.5 * np.log1p(values / ratios).sum(axis=1)
        best = int(np.argmax(evidence))
        ratio = POLICY.ratios[best]
        weights = -vectors @ (along / (values + ratio))
        filled = []
        for term, own in zip(terms, _split(weights, columns), strict=True):
            values = on_device(scaled[len(filled)] @ own)
            filled.append(eqx.tree_at(lambda one: one.weights, term, values))
        return cls(
            terms=tuple(filled),
            log_evidence=float(evidence[best]) - cost(terms, response),
            ratio=ratio,
            columns=x,
            weights=weights,
            left=offset + x @ weights,
        )

    def step(self, damping: float, response: ForceResponse) -> Terms:
        """The terms with the geometry after a step."""
        parts = [slopes(t, response)[:, t.weights.size :] for t in self.terms]
        by_geometry = np.concatenate(parts, axis=1)
        count, size = self.columns.shape[1], by_geometry.shape[1]
        rows = np.concatenate([self.columns, by_geometry], axis=1)
        hessian, gradient = rows.T @ rows, rows.T @ self.left
        gradient[:count] += self.ratio * self.weights
        lengths = np.diagonal(hessian)[count:]
        floor = max(float(lengths.max(initial=0.0)), 1.0) * np.finfo(float).eps
        added = np.full(count + size, self.ratio)
        added[count:] = damping * lengths + floor
        factor = scipy.linalg.cho_factor(hessian + np.diag(added))
        change = -scipy.linalg.cho_solve(factor, gradient)[count:]
        changes = zip(self.terms, _split(change, parts), strict=True)
        return tuple(_with_geometry(term, own) for term, own in changes)


def _split(
    values: Float[np.ndarray, " column"], parts: Sequence[Float[np.ndarray, "_ _"]]
) -> list[Float[np.ndarray, " _"]]:
    """Values of the columns of all parts, part by part."""
    return np.split(values, np.cumsum([part.shape[1] for part in parts])[:-1])


def _with_geometry(
    term: AbstractTerm, change: Float[np.ndarray, " number"]
) -> AbstractTerm:
    """The term with a changed geometry, of which a linear one has none."""
    if not change.size:
        return term
    parametric, theta = ravel_model(term, lambda one: one.geometry)
    return parametric(on_device(np.asarray(theta) + change))


def move(terms: Terms, response: ForceResponse) -> Placed:
    """Terms where they explain most, by a rough smoothness after a finer one."""
    placed = None
    each = [scanned_shapes(term, response) for term in terms]
    for shapes in zip(*each, strict=True):
        pairs = zip(terms, shapes, strict=True)
        roots = [root(term.prior().covariance(shape)) for term, shape in pairs]
        placed = _move_at(Placed.of(terms, roots, response), roots, response)
        terms = placed.terms
    assert placed is not None
    return placed


def _move_at(placed: Placed, roots: Roots, response: ForceResponse) -> Placed:
    """Damped steps at one smoothness, while they gain."""
    damping = 0.01
    for _ in range(POLICY.moves):
        other = Placed.of(placed.step(damping, response), roots, response)
        gain = other.log_evidence - placed.log_evidence
        damping *= 0.2 if gain > 0 else 10.0
        placed = other if gain > 0 else placed
        if 0 < gain < 1.0 or damping > 1e3:
            break
    return placed
