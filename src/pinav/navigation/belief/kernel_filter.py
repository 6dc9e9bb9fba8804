r"""Joint extended Kalman filter of a swimmer's state and of the weights of its force.

With the state y, the weights w and a step $y' = f(y, F(x_m))$, $A = \partial y' /
\partial y$, $B = \partial y' / \partial w$,

$$P_{yw} \leftarrow A P_{yw} + B P_{ww}, \quad
P_{yy} \leftarrow A P_{yy} A^\top + A P_{yw} B^\top + (\cdot)^\top
+ B P_{ww} B^\top + Q,$$

and a position z with the error R changes the mean by $G L^{-1} (z - x)$ and the
covariance by $- G G^\top$, with $L L^\top = P_{xx} + R$ and
$G = P_{\cdot x} L^{-\top}$.

A kernel joins when it first comes into reach. Its prior does not depend on the rest, so
that this is the filter of the whole grid, exactly. The products $G G^\top$ of some
frames are kept as factors and subtracted together: a frame then costs a few rows of
$P_{ww}$, and what was before it stays as it was.
"""

import dataclasses
import math

import numpy as np
from jaxtyping import Float, Int

from pinav.navigation.belief.kernels import AbstractKernels, Local, Points
from pinav.navigation.belief.motion import AbstractMotion, Square, Vector

AT_ONCE = 256
"""Positions whose forces are computed together, to bound the memory."""


@dataclasses.dataclass(frozen=True, eq=False)
class WeightPosterior:
    r"""Weights that were reached: $P_{ww} = \mathrm{diag}(P_0, a^2 I) - G G^\top$.

    Attributes:
        prior_sd: a, of every weight.
        members: which weights they are, in the order of their coming.
        slots: the place of each weight of the grid among them; -1 for none.
        base: P_0, of the first members.
        factors: G.
        cross: $P_{yw}$.
    """

    prior_sd: float
    members: Int[np.ndarray, " member"]
    slots: Int[np.ndarray, " weight"]
    mean: Float[np.ndarray, " member"]
    base: Float[np.ndarray, "first first"]
    factors: Float[np.ndarray, "member factor"]
    cross: Float[np.ndarray, "state member"]

    @classmethod
    def before_data(cls, size: int, states: int, prior_sd: float) -> "WeightPosterior":
        """No weight was reached."""
        none = np.zeros(0, int)
        return cls(
            prior_sd,
            none,
            np.full(size, -1),
            np.zeros(0),
            np.zeros((0, 0)),
            np.zeros((0, 0)),
            np.zeros((states, 0)),
        )

    def mean_of(self, weights: Int[np.ndarray, " near"]) -> Float[np.ndarray, " near"]:
        """Means of weights of the grid: zero for those that were not reached."""
        if not len(self.members):
            return np.zeros(len(weights))
        slots = self.slots[weights]
        return np.where(slots >= 0, self.mean[slots], 0.0)

    def reach(self, weights: Int[np.ndarray, " near"]) -> "WeightPosterior":
        """With these weights among the members."""
        new = weights[self.slots[weights] < 0]
        if not len(new):
            return self
        count, more = len(self.members), len(new)
        slots = self.slots.copy()
        slots[new] = np.arange(count, count + more)
        rows = np.zeros((more, self.factors.shape[1]))
        columns = np.zeros((len(self.cross), more))
        return dataclasses.replace(
            self,
            members=np.concatenate([self.members, new]),
            slots=slots,
            mean=np.concatenate([self.mean, np.zeros(more)]),
            factors=np.concatenate([self.factors, rows]),
            cross=np.concatenate([self.cross, columns], axis=1),
        )

    def rows(
        self, slots: Int[np.ndarray, " near"], weighted: Float[np.ndarray, "state near"]
    ) -> Float[np.ndarray, "state member"]:
        """$B P_{ww}$ for a B that is zero but in these slots."""
        first, old = len(self.base), slots < len(self.base)
        if old.all() and first == len(self.members):
            product = weighted @ self.base[slots]
        else:
            product = np.zeros((len(weighted), len(self.members)))
            product[:, :first] = weighted[:, old] @ self.base[slots[old]]
            product[:, slots[~old]] = self.prior_sd**2 * weighted[:, ~old]
        product -= (weighted @ self.factors[slots]) @ self.factors.T
        return product

    def covariance(self) -> Float[np.ndarray, "member member"]:
        """$P_{ww}$ as one matrix, symmetric."""
        first, count = len(self.base), len(self.members)
        # A product with its own transpose is symmetric to the last bit. It is changed
        # in place: for many members, memory takes longer than arithmetic.
        matrix = self.factors @ self.factors.T
        old = matrix[:first, :first]
        np.subtract(self.base, old, out=old)
        for new in (matrix[:first, first:], matrix[first:]):
            np.negative(new, out=new)
        rest = np.arange(first, count)
        matrix[rest, rest] += self.prior_sd**2
        return matrix

    def settle(self) -> "WeightPosterior":
        """The same with the factors subtracted."""
        nothing = np.zeros((len(self.members), 0))
        return dataclasses.replace(self, base=self.covariance(), factors=nothing)


class ExpectedForce:
    """The mean force, which remembers the kernels where it was last asked for.

    Attributes:
        local: these kernels.
    """

    local: Local

    def __init__(self, kernels: AbstractKernels, weights: WeightPosterior) -> None:
        self._kernels, self._weights = kernels, weights

    def __call__(self, x: Vector) -> tuple[Vector, Square]:
        """Mean force and its slope dF/dx at a position [L]."""
        self.local = self._kernels.at(x)
        mean = self._weights.mean_of(self.local.weights)
        return self.local.basis @ mean, self.local.slope @ mean


@dataclasses.dataclass(frozen=True, eq=False)
class KernelFilter:
    """State and force for one kind of kernels and one length scale.

    Attributes:
        spread: covariance $P_{yy}$ of the state.
    """

    kernels: AbstractKernels
    motion: AbstractMotion
    state: Float[np.ndarray, " state"]
    spread: Square
    weights: WeightPosterior
    log_evidence: float = 0.0

    def predict(self, thrust: Vector, duration: float) -> "KernelFilter":
        """Moved on by a step."""
        surroundings = ExpectedForce(self.kernels, self.weights)
        move = self.motion.step(self.state, surroundings, thrust, duration)
        local = surroundings.local
        weights = self.weights.reach(local.weights)
        slots = weights.slots[local.weights]
        by_weight = move.by_force @ local.basis
        through = weights.rows(slots, by_weight)
        old_cross = move.slope @ weights.cross
        mixed = old_cross[:, slots] @ by_weight.T
        spread = move.slope @ self.spread @ move.slope.T + move.noise
        spread += mixed + mixed.T + through[:, slots] @ by_weight.T
        return dataclasses.replace(
            self,
            state=move.state,
            spread=(spread + spread.T) / 2,
            weights=dataclasses.replace(weights, cross=old_cross + through),
        )

    def update(self, position: Vector, sd: float) -> "KernelFilter":
        """With an observed position."""
        dim, weights = len(position), self.weights
        error = position - self.state[:dim]
        observed = self.spread[:dim, :dim] + sd**2 * np.eye(dim)
        inverse = np.linalg.inv(np.linalg.cholesky(observed))
        surprise = inverse @ error
        by_state = self.spread[:, :dim] @ inverse.T
        by_weight = weights.cross[:dim].T @ inverse.T
        spread = self.spread - by_state @ by_state.T
        density = -0.5 * float(surprise @ surprise) - float(
            dim / 2 * math.log(2 * math.pi) - np.sum(np.log(np.diagonal(inverse)))
        )
        factors = [weights.factors, by_weight]
        return dataclasses.replace(
            self,
            state=self.state + by_state @ surprise,
            spread=(spread + spread.T) / 2,
            weights=dataclasses.replace(
                weights,
                mean=weights.mean + by_weight @ surprise,
                factors=np.concatenate(factors, axis=1),
                cross=weights.cross - by_state @ by_weight.T,
            ),
            log_evidence=self.log_evidence + density,
        )

    def settle(self) -> "KernelFilter":
        """The same with its factors subtracted."""
        return dataclasses.replace(self, weights=self.weights.settle())

    def restart(
        self, state: Float[np.ndarray, " state"], spread: Square
    ) -> "KernelFilter":
        """With another state, which the weights do not know; they stay."""
        cross = np.zeros_like(self.weights.cross)
        weights = dataclasses.replace(self.weights, cross=cross)
        return dataclasses.replace(self, state=state, spread=spread, weights=weights)

    def force(
        self, points: Points
    ) -> tuple[Float[np.ndarray, "point dim"], Float[np.ndarray, "point dim"]]:
        """Mean and standard deviation of each component of the force at positions."""
        covariance, parts = self.weights.covariance(), []
        for first in range(0, len(points), AT_ONCE):
            basis = self.kernels.basis(points[first : first + AT_ONCE])
            parts.append(self._force(basis, covariance))
        if not parts:
            return np.zeros_like(points), np.zeros_like(points)
        means, sds = zip(*parts, strict=True)
        return np.concatenate(means), np.concatenate(sds)

    def _force(
        self,
        basis: Float[np.ndarray, "point dim weight"],
        covariance: Float[np.ndarray, "member member"],
    ) -> tuple[Float[np.ndarray, "point dim"], Float[np.ndarray, "point dim"]]:
        weights = self.weights
        known = basis[..., weights.members]
        flat = known.reshape(len(basis) * basis.shape[1], known.shape[-1])
        variance = np.einsum("ij,ij->i", flat @ covariance, flat)
        unseen = np.einsum("pdw,pdw->pd", basis, basis)
        unseen -= np.einsum("pdw,pdw->pd", known, known)
        variance = variance.reshape(unseen.shape) + weights.prior_sd**2 * unseen
        return known @ weights.mean, np.sqrt(np.maximum(variance, 0.0))

    def all_weights(self) -> Float[np.ndarray, " weight"]:
        """Mean of every weight of the grid."""
        mean = np.zeros(self.kernels.size)
        mean[self.weights.members] = self.weights.mean
        return mean

    def sample_weights(
        self, count: int, seed: int
    ) -> Float[np.ndarray, "{count} weight"]:
        """Draws of every weight of the grid."""
        random, weights = np.random.default_rng(seed), self.weights
        numbers = random.standard_normal((count, self.kernels.size))
        draws, members = weights.prior_sd * numbers, weights.members
        spread = weights.covariance()
        # What was seen often is known to rounding: the factor must exist for it too.
        least = 1e-9 * weights.prior_sd**2 + np.finfo(float).tiny
        factor = np.linalg.cholesky(spread + least * np.eye(len(members)))
        draws[:, members] = weights.mean + numbers[:, members] @ factor.T
        return draws

    @property
    def nbytes(self) -> int:
        """Memory that it takes [byte]."""
        weights = self.weights
        arrays = (weights.base, weights.factors, weights.cross, weights.slots)
        return sum(array.nbytes for array in arrays)
