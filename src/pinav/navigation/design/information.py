r"""Which trajectory to record next: the one that tells most of a route.

From a fit's Laplace posterior, with covariance $C$ of the parameters, a trajectory
that would be observed with noise $\sigma$ makes
$C' = (C^{-1} + J^\top J / \sigma^2)^{-1}$ expected, where $J$ are the derivatives of
its samples by the parameters, its start eliminated. What counts is the covariance
$G C' G^\top$ of the force along the route.

References:
    MacKay, Neural Computation 4, 590 (1992); Chaloner and Verdinelli, Statistical
    Science 10, 273 (1995), for the criteria.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, PRNGKeyArray, PyTree

from pinav.arguments import Planar, check_positive
from pinav.dynamics import AbstractDynamics, FixedStep
from pinav.errors import InputError
from pinav.fitting.engine.multiple_shooting import eliminate, sensitivities
from pinav.fitting.engine.parametric_model import ParametricModel
from pinav.fitting.engine.posterior import Posterior
from pinav.navigation.design.candidates import (
    CandidateTrajectories,
    CommandedThrust,
    Experiment,
)
from pinav.navigation.task.zones import Rectangle

Covariance = Float[Array, "force force"]


class AbstractCriterion(eqx.Module):
    """What a trajectory is worth."""

    @abc.abstractmethod
    def __call__(self, before: Covariance, after: Covariance) -> Float[Array, ""]:
        """Worth of a change of the covariance of all forces along the route."""


class VarianceReduction(AbstractCriterion):
    r"""Expected fall of the mean squared error, $(\mathrm{tr}\,S - \mathrm{tr}\,S')/n$.

    In [L² T⁻⁴] for each of the $n$ components along the route.
    """

    def __call__(self, before: Covariance, after: Covariance) -> Float[Array, ""]:
        return (jnp.trace(before) - jnp.trace(after)) / before.shape[0]


class InformationGain(AbstractCriterion):
    r"""Expected information on the forces, $\tfrac12 \log\det S - \tfrac12\log\det S'$.

    In nats, for forces of which differences below a resolution do not matter, so that
    its square is added to each variance. It counts a point that is already known well
    as much as one that is not, and prefers trajectories that improve many points.

    Attributes:
        resolution: [L T⁻²], positive.

    Raises:
        InputError: `resolution` is not positive.
    """

    resolution: float

    def __check_init__(self) -> None:
        check_positive(self, "resolution")

    def __call__(self, before: Covariance, after: Covariance) -> Float[Array, ""]:
        floor = self.resolution**2 * jnp.eye(before.shape[0], dtype=before.dtype)
        logs = (jnp.linalg.slogdet(s + floor)[1] for s in (before, after))
        return 0.5 * (next(logs) - next(logs))


class Ranking(eqx.Module):
    """Candidates and what they are expected to tell.

    Attributes:
        candidates: the candidates.
        worth: of each by the criterion; minus infinity where it would leave the arena.
        sd: expected root mean square of the standard deviations of the force along
            the route, after each candidate [L T⁻²].
        sd_now: the same before any of them.
    """

    candidates: CandidateTrajectories
    worth: Float[np.ndarray, " candidate"]
    sd: Float[np.ndarray, " candidate"]
    sd_now: float

    @property
    def best(self) -> int:
        """Index of the candidate of most worth.

        Raises:
            InputError: every candidate leaves the arena.
        """
        if not np.isfinite(self.worth).any():
            raise InputError(
                "suggest: each of the candidates leaves the arena; expected one that "
                "stays inside, so make trajectories shorter or try more of them"
            )
        return int(np.argmax(self.worth))


def rank(
    posterior: Posterior,
    route: ArrayLike,
    experiment: Experiment,
    candidates: CandidateTrajectories,
    *,
    arena: Rectangle,
    criterion: AbstractCriterion | None = None,
    draws: int = 1,
    key: PRNGKeyArray | None = None,
) -> Ranking:
    """What each candidate would tell of the force along a route.

    Args:
        posterior: of a fit of a swimmer; commands replace its propulsion.
        route: points, one a row [L].
        experiment: how the candidates would be recorded.
        candidates: the candidates.
        arena: what they should not leave, as far as the model knows.
        criterion: `VarianceReduction()` unless given.
        draws: models from the posterior along whose rollouts the worth is averaged;
            the mean alone where it is 1.
        key: random key of the draws, needed where there are several.

    Raises:
        InputError: `route` is no list of points in the plane, or draws have no key.
    """
    criterion = VarianceReduction() if criterion is None else criterion
    points = _check_route(route)
    with jax.enable_x64(new_val=True):
        thetas = _thetas(posterior, draws, key)
        root = jnp.asarray(_root(posterior.covariance))
        request = _Request(posterior.free, root, jnp.asarray(points), experiment)
        worth, traces, inside, before = _rank(
            request, thetas, candidates, arena, criterion
        )
    stays = np.asarray(inside).all(axis=1)
    count = points.size
    return Ranking(
        candidates=candidates,
        worth=np.where(stays, np.asarray(worth).mean(axis=1), -np.inf),
        sd=np.sqrt(np.asarray(traces).mean(axis=1) / count),
        sd_now=float(np.sqrt(before / count)),
    )


def suggest(
    posterior: Posterior,
    route: ArrayLike,
    experiment: Experiment,
    *,
    arena: Rectangle,
    key: PRNGKeyArray,
    num_candidates: int = 64,
    rounds: int = 2,
    criterion: AbstractCriterion | None = None,
    draws: int = 1,
) -> Ranking:
    """Look for the trajectory that tells most of the force along a route.

    The first round ranks random candidates, each later one variations of the best.

    Args:
        posterior: of a fit of a swimmer.
        route: points, one a row [L].
        experiment: how trajectories are recorded.
        arena: what they should not leave.
        key: random key.
        num_candidates: of each round.
        rounds: one or more.
        criterion: `VarianceReduction()` unless given.
        draws: see `rank`.

    Returns:
        The ranking of the last round, which contains the best of all.

    Raises:
        InputError: `rounds` or `candidates` is not positive, or every candidate leaves
            the arena.
    """
    if rounds < 1 or num_candidates < 1:
        raise InputError(
            f"suggest: expected 1 or more rounds and candidates, got {rounds} and "
            f"{num_candidates}"
        )
    draw_key, *keys = jax.random.split(key, rounds + 1)
    options = {"arena": arena, "criterion": criterion, "draws": draws, "key": draw_key}
    candidates = experiment.draw(num_candidates, key=keys[0])
    ranking = rank(posterior, route, experiment, candidates, **options)
    for later in keys[1:]:
        best = ranking.candidates[ranking.best]
        varied = experiment.vary(best, num_candidates - 1, key=later)
        candidates = jax.tree.map(
            lambda first, others: jnp.concatenate([first[None], others]), best, varied
        )
        ranking = rank(posterior, route, experiment, candidates, **options)
    return ranking


def expected_posterior(
    posterior: Posterior, experiment: Experiment, candidate: CandidateTrajectories
) -> Posterior:
    """The posterior that is expected after a trajectory: same mean, less covariance.

    For suggesting several trajectories at once.

    Args:
        posterior: before it.
        experiment: how the trajectory would be recorded.
        candidate: a single one.
    """
    with jax.enable_x64(new_val=True):
        root = jnp.asarray(_root(posterior.covariance))
        theta = jnp.asarray(posterior.mean)
        request = _Request(posterior.free, root, jnp.zeros((0, 2)), experiment)
        root = np.asarray(_root_after(request, theta, candidate))
    return Posterior(posterior.free, posterior.mean, root @ root.T)


class _Request(eqx.Module):
    """What all candidates share: `root` times its transpose is the covariance."""

    free: ParametricModel
    root: Float[Array, "parameter rank"]
    route: Float[Array, "point 2"]
    experiment: Experiment

    def forces(self, theta: Float[Array, " parameter"]) -> Float[Array, "force rank"]:
        """Derivatives of all forces along the route by the whitened parameters."""

        def force(theta: Float[Array, " parameter"], x: Planar) -> Planar:
            return self.free(theta).environment(0.0, x, jnp.zeros_like(x))

        jacobians = jax.vmap(jax.jacrev(force), (None, 0))(theta, self.route)
        return jacobians.reshape(-1, theta.shape[0]) @ self.root

    def rollout(
        self, theta: Float[Array, " parameter"], candidate: CandidateTrajectories
    ) -> tuple[Float[Array, "time state"], Float[Array, "row rank"]]:
        """States of a candidate, and what it tells: rows in whitened parameters."""
        driven = _with_thrust(self.free, self.experiment.thrust(candidate))
        times, solver = self.experiment.times, FixedStep()
        states, _ = solver.solve(driven(theta), candidate.starts, times)
        columns = sensitivities(driven, theta, states, times, solver).columns[..., :-1]
        rows = columns / self.experiment.noise[None, :, None]
        count = theta.shape[0]
        rest, _, _ = eliminate(rows.reshape(-1, rows.shape[2]), count, states.shape[1])
        return states, rest @ self.root

    def factor(self, rows: Float[Array, "row rank"]) -> Float[Array, "rank rank"]:
        r"""Cholesky factor of $1 + R^\top R$, the precision of the whitened ones."""
        unit = jnp.eye(rows.shape[1], dtype=rows.dtype)
        return jnp.linalg.cholesky(unit + rows.T @ rows)


@eqx.filter_jit
def _rank(
    request: _Request,
    thetas: Float[Array, "draw parameter"],
    candidates: CandidateTrajectories,
    arena: Rectangle,
    criterion: AbstractCriterion,
) -> tuple[
    Float[Array, "candidate draw"],
    Float[Array, "candidate draw"],
    Bool[Array, "candidate draw"],
    Float[Array, ""],
]:
    forces = jax.vmap(request.forces)(thetas)
    prior = jax.vmap(lambda rows: rows @ rows.T)(forces)

    def one(
        candidate: CandidateTrajectories,
        theta: Float[Array, " parameter"],
        rows: Float[Array, "force rank"],
        before: Covariance,
    ) -> tuple[Float[Array, ""], Float[Array, ""], Bool[Array, ""]]:
        states, rows_of_data = request.rollout(theta, candidate)
        left = jax.scipy.linalg.solve_triangular(
            request.factor(rows_of_data), rows.T, lower=True
        )
        after = left.T @ left
        finite = jnp.all(jnp.isfinite(rows_of_data))
        inside = jnp.all(jax.vmap(arena.distance)(states[:, :2]) <= 0) & finite
        return criterion(before, after), jnp.trace(after), inside

    def each(
        candidate: CandidateTrajectories,
    ) -> tuple[Float[Array, " draw"], Float[Array, " draw"], Bool[Array, " draw"]]:
        several = jax.vmap(one, (None, 0, 0, 0))
        return several(candidate, thetas, forces, prior)

    worth, traces, stays = jax.lax.map(each, candidates)
    return worth, traces, stays, jnp.mean(jnp.trace(prior, axis1=1, axis2=2))


@eqx.filter_jit
def _root_after(
    request: _Request,
    theta: Float[Array, " parameter"],
    candidate: CandidateTrajectories,
) -> Float[Array, "parameter rank"]:
    """Root of the covariance after a candidate."""
    _, rows_of_data = request.rollout(theta, candidate)
    factor = request.factor(rows_of_data)
    return jax.scipy.linalg.solve_triangular(factor, request.root.T, lower=True).T


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


def _thetas(
    posterior: Posterior, draws: int, key: PRNGKeyArray | None
) -> Float[Array, "draw parameter"]:
    mean = jnp.asarray(posterior.mean)
    if draws == 1:
        return mean[None]
    if key is None:
        raise InputError(f"rank: {draws} draws need key=jax.random.key(seed)")
    root = jnp.asarray(_root(posterior.covariance))
    normal = jax.random.normal(key, (draws, root.shape[1]), jnp.float64)
    return mean[None] + normal @ root.T


def _root(covariance: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n rank"]:
    """A matrix whose product with its transpose is the covariance."""
    values, vectors = np.linalg.eigh(covariance)
    kept = values > 1e-12 * max(values[-1], 0.0)
    return vectors[:, kept] * np.sqrt(values[kept])


def _check_route(route: ArrayLike) -> Float[np.ndarray, "point 2"]:
    points = np.asarray(route, float)
    if points.ndim != 2 or points.shape[1] != 2 or not len(points):
        raise InputError(
            f"route: expected points in the plane, one a row, got shape {points.shape}"
        )
    return points


@eqx.filter_jit
def inside(
    model: AbstractDynamics,
    experiment: Experiment,
    candidates: CandidateTrajectories,
    arena: Rectangle,
) -> Bool[Array, " candidate"]:
    """Which candidates stay inside the arena, as far as a model knows."""

    def one(candidate: CandidateTrajectories) -> Bool[Array, ""]:
        driven = eqx.tree_at(
            lambda m: m.propulsion, model, experiment.thrust(candidate)
        )
        states, _ = FixedStep().solve(driven, candidate.starts, experiment.times)
        return jnp.all(jax.vmap(arena.distance)(states[:, :2]) <= 0)

    return jax.lax.map(one, candidates)
