r"""Beliefs that take a force for granted, or begin with that of an earlier fit.

The force is $F(x) = F_0(x) + B(x) w$ with the fitted $F_0$, and the kernels correct it.
Where the fit had data, it knows the error of $F_0$ up to a covariance C: that is an
observation of the correction at places X,

$$0 = B(X) w + \varepsilon, \qquad \varepsilon \sim N(0, C),$$

and elsewhere the kernels keep the prior of one who knows nothing.
"""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.interpolate import RectBivariateSpline
from scipy.linalg import solve_triangular

from pinav.navigation.belief.belief import Belief, Frame
from pinav.navigation.belief.kernel_filter import KernelFilter, WeightPosterior
from pinav.navigation.belief.kernels import AbstractKernels, KernelGrid, Local, Points
from pinav.navigation.belief.motion import AbstractMotion, Square

Axis = Float[np.ndarray, " _"]


@dataclasses.dataclass(frozen=True, eq=False)
class GivenForce(AbstractKernels):
    """One planar force with one weight, its factor; the grid spans the arena."""

    splines: tuple[RectBivariateSpline, RectBivariateSpline]

    @classmethod
    def of(
        cls, axes: tuple[Axis, Axis], force: Float[np.ndarray, "x y 2"]
    ) -> "GivenForce":
        """The force whose values on a lattice are given."""
        lower = np.array([along[0] for along in axes])
        grid = KernelGrid(lower, float(axes[0][-1] - axes[0][0]), (2, 2))
        x, y = (RectBivariateSpline(*axes, force[..., k]) for k in range(2))
        return cls(grid, (x, y))

    @property
    def size(self) -> int:
        return 1

    def at(self, x: Float[np.ndarray, " dim"]) -> Local:
        parts = [(0, 0), (1, 0), (0, 1)]
        rates = np.array(
            [[s.ev(x[0], x[1], dx=i, dy=j) for i, j in parts] for s in self.splines]
        )
        return Local(np.zeros(1, int), rates[:, :1], rates[:, 1:, None])

    def basis(self, points: Points) -> Float[np.ndarray, "point dim weight"]:
        return np.stack(
            [s.ev(points[:, 0], points[:, 1]) for s in self.splines], axis=1
        )[..., None]

    def on_axes(
        self, axes: Sequence[Axis], weights: Float[np.ndarray, "... weight"]
    ) -> Float[np.ndarray, "... dim"]:
        force = np.stack([s(axes[0], axes[1]) for s in self.splines], axis=-1)
        return weights[..., None, None] * force


FIRST_SPEED = 0.1
"""Standard deviation of the first velocity of who knows the force."""


def take_for_granted(
    force: GivenForce, frame: Frame, *, motion: AbstractMotion, longest: float = 0.1
) -> Belief:
    """The belief of one who knows the force: what it learns is the state."""
    assert frame.position is not None
    state, spread = motion.start(frame.position, frame.sd, FIRST_SPEED)
    empty = WeightPosterior.before_data(1, len(state), 0.0).reach(np.zeros(1, int))
    weights = dataclasses.replace(empty, mean=np.ones(1))
    one = KernelFilter(force, motion, state, spread, weights)
    return Belief(float(frame.time), (one,), 0, 1, longest)


TRUST = 0.9
"""Probability, before the first frame, that the surroundings are those of the fit."""

FELT = 3e-4
"""Force of a unit of a weight below which its kernel is not felt at a place."""


@dataclasses.dataclass(frozen=True, eq=False)
class CorrectedForce(AbstractKernels):
    """Kernels that correct a given force, whose factor is the last weight."""

    kernels: AbstractKernels
    given: GivenForce

    @property
    def size(self) -> int:
        return self.kernels.size + 1

    def at(self, x: Float[np.ndarray, " dim"]) -> Local:
        near, given = self.kernels.at(x), self.given.at(x)
        return Local(
            np.append(near.weights, self.kernels.size),
            np.concatenate([near.basis, given.basis], axis=-1),
            np.concatenate([near.slope, given.slope], axis=-1),
        )

    def basis(self, points: Points) -> Float[np.ndarray, "point dim weight"]:
        parts = self.kernels.basis(points), self.given.basis(points)
        return np.concatenate(parts, axis=-1)

    def on_axes(
        self, axes: Sequence[Axis], weights: Float[np.ndarray, "... weight"]
    ) -> Float[np.ndarray, "... dim"]:
        correction = self.kernels.on_axes(axes, weights[..., :-1])
        return correction + self.given.on_axes(axes, weights[..., -1:])


@dataclasses.dataclass(frozen=True, eq=False)
class BeliefPrior:
    """The force of an earlier fit, and how well its data told it.

    Attributes:
        places: where there were data [L].
        covariance: of the components of its error there, place by place.
    """

    force: GivenForce
    places: Points
    covariance: Square

    def lead(self, belief: Belief) -> Belief:
        """A belief of one frame in which this prior leads.

        The force is corrected by the kernels of the bank under which it is most
        probable. The filters that know nothing stay in the bank: where the surroundings
        are no longer those of the fit, their evidence will be better.
        """
        densities = [self._log_density(one) for one in belief.filters]
        likely = belief.filters[int(np.argmax(densities))]
        odds = TRUST / (1 - TRUST) * len(belief.filters)
        first = dataclasses.replace(self._correct(likely), log_evidence=math.log(odds))
        filters = (first, *belief.filters)
        return dataclasses.replace(belief, filters=filters, leader=0)

    def _log_density(self, before: KernelFilter) -> float:
        """Log density of the fitted force by a filter; a constant off."""
        root = np.linalg.cholesky(self._variance(self._columns(before)))
        force = self.force.basis(self.places).ravel()
        surprise = solve_triangular(root, force, lower=True)
        return float(-0.5 * surprise @ surprise - np.sum(np.log(np.diagonal(root))))

    def _columns(self, one: KernelFilter) -> Float[np.ndarray, "component weight"]:
        """Force at the places of a standard deviation of each weight."""
        basis = one.kernels.basis(self.places)
        return one.weights.prior_sd * basis.reshape(-1, one.kernels.size)

    def _variance(self, columns: Float[np.ndarray, "component weight"]) -> Square:
        """Variance of the fit's observation of kernels at the places."""
        return columns @ columns.T + self.covariance

    def _correct(self, before: KernelFilter) -> KernelFilter:
        """The filter of the correction of the force."""
        kernels, sd = before.kernels, before.weights.prior_sd
        columns = self._columns(before)
        felt = np.flatnonzero(np.max(np.abs(columns), axis=0) > FELT * sd)
        root = np.linalg.cholesky(self._variance(columns))
        known = sd * solve_triangular(root, columns[:, felt], lower=True).T
        # The given force comes first, because the prior of the first weights is a
        # matrix of its own: here a zero, for its factor is known.
        members = np.append(kernels.size, felt)
        slots = np.full(kernels.size + 1, -1)
        slots[members] = np.arange(len(members))
        weights = WeightPosterior(
            prior_sd=sd,
            members=members,
            slots=slots,
            mean=np.append(1.0, np.zeros(len(felt))),
            base=np.zeros((1, 1)),
            factors=np.concatenate([np.zeros((1, known.shape[1])), known]),
            cross=np.zeros((len(before.state), len(members))),
        )
        return dataclasses.replace(
            before,
            kernels=CorrectedForce(kernels.grid, kernels, self.force),
            weights=weights.settle(),
        )
