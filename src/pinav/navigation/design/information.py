r"""Expected information of a trajectory on the force along a way.

A candidate is worth what it leaves unknown: the standard deviation of the force along
the way that is expected after it, by whatever knows the force. From a fit's Laplace
posterior, with covariance $C$ of the parameters, a trajectory that would be observed
with noise $\sigma$ makes $C' = (C^{-1} + J^\top J / \sigma^2)^{-1}$ expected, where $J$
are the derivatives of its samples by the parameters, its start eliminated; what counts
is the mean of the variances on the diagonal of $G C' G^\top$, with the derivatives $G$
of the force along the way.

References:
    MacKay, Neural Computation 4, 590 (1992); Chaloner and Verdinelli, Statistical
    Science 10, 273 (1995).
"""

import math
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, PRNGKeyArray, PyTree

from pinav.arguments import Planar
from pinav.dynamics import FixedStep
from pinav.errors import InputError
from pinav.fitting.engine.constant_priors import ParametricModel
from pinav.fitting.engine.multiple_shooting import eliminate, sensitivities
from pinav.fitting.engine.posterior import Posterior
from pinav.navigation.design.candidates import (
    CandidateTrajectories,
    CommandedThrust,
    Experiment,
)
from pinav.navigation.task.task import Rectangle

ExpectedSd = Callable[[CandidateTrajectories], float]
"""Standard deviation of the force along a way that is expected after a single
candidate; infinite where it should enter something forbidden."""


def best_candidate(
    expected_sd: ExpectedSd,
    experiment: Experiment,
    first: CandidateTrajectories,
    *,
    variations: int,
    keys: Sequence[PRNGKeyArray],
) -> tuple[CandidateTrajectories, float]:
    """The candidate after which the force should be known best, and how well.

    Args:
        expected_sd: judges a candidate.
        experiment: recording of the trajectories.
        first: candidates of the first round.
        variations: variations of the best one in each later round.
        keys: random key of each later round.
    """
    best, least = _best(expected_sd, first)
    for key in keys:
        varied = experiment.vary(best, variations, key=key)
        other, sd = _best(expected_sd, varied)
        if sd < least:
            best, least = other, sd
    return best, least


def _best(
    expected_sd: ExpectedSd, candidates: CandidateTrajectories
) -> tuple[CandidateTrajectories, float]:
    """The candidate of the smallest expected standard deviation, and that."""
    count = len(candidates.starts)
    sds = [expected_sd(candidates[k]) for k in range(count)]
    best = int(np.argmin(sds))
    return candidates[best], sds[best]


class PosteriorInformation(eqx.Module):
    """Expected information by the posterior of a fit.

    Attributes:
        free: swimmer as a function of its parameters; commands replace its propulsion.
        root: matrix whose product with its transpose is their covariance.
        way: points along which the force matters [L].
        arena: what they should not leave, as far as the model knows.
    """

    free: ParametricModel
    theta: Float[Array, " parameter"]
    root: Float[Array, "parameter rank"]
    way: Float[Array, "point 2"]
    experiment: Experiment
    arena: Rectangle

    @classmethod
    def of(
        cls,
        posterior: Posterior,
        way: ArrayLike,
        experiment: Experiment,
        arena: Rectangle,
    ) -> "PosteriorInformation":
        """The information on the force along a way, one point a row [L].

        Raises:
            InputError: `way` is no list of points in the plane.
        """
        points = np.asarray(way, float)
        if points.ndim != 2 or points.shape[1] != 2 or not len(points):
            raise InputError(
                "route: expected points in the plane, one a row, got shape "
                f"{points.shape}"
            )
        with jax.enable_x64(new_val=True):
            return cls(
                posterior.free,
                jnp.asarray(posterior.mean),
                jnp.asarray(_root(posterior.covariance)),
                jnp.asarray(points),
                experiment,
                arena,
            )

    @property
    def sd_now(self) -> float:
        """Standard deviation of the force along the way before any candidate."""
        with jax.enable_x64(new_val=True):
            return float(jnp.sqrt(jnp.mean(jnp.sum(_forces(self) ** 2, axis=1))))

    def __call__(self, candidate: CandidateTrajectories) -> float:
        with jax.enable_x64(new_val=True):
            variance, stays = _after(self, candidate)
        return math.sqrt(variance) if stays else math.inf

    def rollout(
        self, candidate: CandidateTrajectories
    ) -> tuple[Float[Array, "time state"], Float[Array, "row rank"]]:
        """States of a candidate, and what it tells: rows in whitened parameters."""
        driven = _with_thrust(self.free, self.experiment.thrust(candidate))
        times, solver = self.experiment.times, FixedStep()
        states, _ = solver.solve(driven(self.theta), candidate.starts, times)
        jacobian = sensitivities(driven, self.theta, states, times, solver)
        rows = jacobian.columns[..., :-1] / self.experiment.noise[None, :, None]
        count = self.theta.shape[0]
        rest, _, _ = eliminate(rows.reshape(-1, rows.shape[2]), count, states.shape[1])
        return states, rest @ self.root


@eqx.filter_jit
def _forces(information: PosteriorInformation) -> Float[Array, "force rank"]:
    """Derivatives of the forces along the way by the whitened parameters."""

    def force(theta: Float[Array, " parameter"], x: Planar) -> Planar:
        return information.free(theta).environment(0.0, x, jnp.zeros_like(x))

    slopes = jax.vmap(jax.jacrev(force), (None, 0))(information.theta, information.way)
    return slopes.reshape(-1, information.theta.shape[0]) @ information.root


@eqx.filter_jit
def _after(
    information: PosteriorInformation, candidate: CandidateTrajectories
) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    """Mean variance of the forces after a candidate; True where it stays inside."""
    states, rows = information.rollout(candidate)
    # The Cholesky factor of the precision of the whitened parameters.
    factor = jnp.linalg.cholesky(jnp.eye(rows.shape[1]) + rows.T @ rows)
    forces = _forces(information)
    left = jax.scipy.linalg.solve_triangular(factor, forces.T, lower=True)
    distances = jax.vmap(information.arena.distance)(states[:, :2])
    stays = jnp.all(distances <= 0) & jnp.all(jnp.isfinite(rows))
    return jnp.mean(jnp.sum(left**2, axis=0)), stays


def _with_thrust(free: ParametricModel, thrust: CommandedThrust) -> ParametricModel:
    """The model as a function of its parameters, its propulsion replaced.

    A learned constant of the old propulsion is then a parameter without effect.
    """

    def propulsion(tree: PyTree) -> PyTree:
        return tree.propulsion

    nothing = jax.tree.map(lambda _: None, thrust)
    static = eqx.tree_at(propulsion, free.static, thrust, is_leaf=lambda x: x is None)

    def unravel(theta: Float[Array, " parameter"]) -> PyTree:
        leaves = free.unravel(theta)
        return eqx.tree_at(propulsion, leaves, nothing, is_leaf=lambda x: x is None)

    return ParametricModel(static, unravel)


def _root(covariance: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n rank"]:
    """A matrix whose product with its transpose is the covariance."""
    values, vectors = np.linalg.eigh(covariance)
    kept = values > 1e-12 * max(values[-1], 0.0)
    return vectors[:, kept] * np.sqrt(values[kept])
