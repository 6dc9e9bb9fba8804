r"""Damped Gauss-Newton steps: several dampings at once, each with chord iterations.

For each damping $\lambda$, with the Jacobian $J$ held and the true residuals $r$,
$d \leftarrow d - (J^\top J + \lambda)^{-1} (J^\top r(\theta + d) + \lambda d)$, which
follows the curvature of a network far beyond the linear model. The best point wins.

References:
    Levenberg 1944; Marquardt 1963.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Scalar, State

Residuals = Callable[[Float[Array, " parameter"]], Float[Array, " residual"]]
"""Residuals as a function of the parameters."""

NETWORK_DAMPING = 1e3
"""Damping of the first step of a random network: with less, a third of the networks
saturate and learn no more."""


class LinearisedResiduals(NamedTuple):
    """Residuals about the parameters at which a step begins.

    Attributes:
        residual: the residuals there.
        jacobian: their derivative there.
        damping: of the last step.
    """

    residuals: Residuals
    theta: Float[Array, " parameter"]
    residual: Float[Array, " residual"]
    jacobian: Float[Array, "residual parameter"]
    damping: Float[Array, ""]

    def along(
        self, directions: Float[Array, "parameter direction"]
    ) -> "LinearisedResiduals":
        """The same as a function of coordinates along some directions."""
        return LinearisedResiduals(
            lambda z: self.residuals(self.theta + directions @ z),
            jnp.zeros(directions.shape[1], self.theta.dtype),
            self.residual,
            self.jacobian @ directions,
            self.damping,
        )


class DampedStep(eqx.Module):
    """Where the best of several damped steps leads.

    Attributes:
        theta: the parameters; those before where no step lowers the squares.
        damping: of that step, or of the next one to try.
        left: share of the sum of squares that is left.
        promised: share of the squares that the linear model promised to save.
    """

    theta: Float[Array, " parameter"]
    damping: Float[Array, ""]
    left: Float[Array, ""]
    promised: Float[Array, ""]


class _Coordinates(NamedTuple):
    """Coordinates z of a step, in which the damped normal equations are solved.

    Attributes:
        zero: the coordinates of no step.
        move: the change of the parameters at z.
        pull_back: the gradient of residuals by z.
        solver: from a damping to the solution of the normal equations.
        least: damping below which the normal matrix may be indefinite.
    """

    zero: Float[Array, " coordinate"]
    move: Callable[[Array], Array]
    pull_back: Callable[[Array], Array]
    solver: Callable[[Float[Array, ""]], Callable[[Array], Array]]
    least: Float[Array, ""]


DAMPINGS = (0.01, 0.1, 1.0, 10.0)
"""Dampings of a step with the whole Jacobian, in units of that of the last step."""

CHORD_STEPS = 3
"""Iterations with the whole Jacobian held."""

ROUNDING = 1e-15
"""Least damping, in units of the trace of the normal matrix."""


def full_step(
    problem: LinearisedResiduals,
    *,
    directions: Float[Array, "parameter direction"] | None = None,
    dampings: tuple[float, ...] = DAMPINGS,
    chord_steps: int = CHORD_STEPS,
) -> DampedStep:
    """The best of several damped steps with the whole Jacobian.

    A projection loses what it does not hold: with the same few directions in each step
    the residual outside them stays. The normal matrix is that of the rows where they
    are fewer than the parameters.

    Args:
        directions: along which the step is sought and damped; all unless given.
        dampings: those that are tried, in units of the last one.
        chord_steps: iterations with the Jacobian held.
    """
    if directions is not None:
        inner = problem.along(directions)
        step = full_step(inner, dampings=dampings, chord_steps=chord_steps)
        theta = problem.theta + directions @ step.theta
        return dataclasses.replace(step, theta=theta)
    jacobian = problem.jacobian
    # The smaller of both normal matrices gives the same step.
    tall = jacobian.shape[0] >= jacobian.shape[1]
    normal = jacobian.T @ jacobian if tall else jacobian @ jacobian.T

    def solver(damping: Float[Array, ""]) -> Callable[[Array], Array]:
        # Only the lower triangle is read: to symmetrise it first costs a fifth more.
        damped = normal + damping * jnp.eye(normal.shape[0])
        factor = jax.lax.linalg.cholesky(damped, symmetrize_input=False)
        return lambda gradient: jax.scipy.linalg.cho_solve((factor, True), gradient)

    dtype = problem.theta.dtype
    coordinates = _Coordinates(
        zero=jnp.zeros(normal.shape[0], dtype),
        move=lambda z: z if tall else jacobian.T @ z,
        pull_back=lambda residual: jacobian.T @ residual if tall else residual,
        solver=solver,
        least=ROUNDING * jnp.trace(normal),
    )
    tried = problem.damping * jnp.asarray(dampings, dtype)
    # One after the other: LAPACK's batched solves wait for threads of the very pool
    # they run on, and on few cores never end.
    return _best_step(problem, coordinates, tried, chord_steps, jax.lax.map)


def damped_step(
    problem: LinearisedResiduals, *, rank: int, num_dampings: int, chord_steps: int
) -> DampedStep:
    """The best of several damped steps with a projection of the Jacobian.

    After the first iteration there are `chord_steps` more; see `GaussNewton`.
    """
    left, scale, right = low_rank(problem.jacobian, rank)
    dtype = problem.theta.dtype
    coordinates = _Coordinates(
        zero=jnp.zeros_like(scale),
        move=lambda z: right @ z,
        pull_back=lambda residual: scale * (left.T @ residual),
        solver=lambda damping: lambda gradient: gradient / (scale**2 + damping),
        least=jnp.zeros((), dtype),
    )
    # All smaller but the last two: a step that works is followed by a bolder one.
    exponents = jnp.arange(num_dampings) - (num_dampings - 2)
    tried = problem.damping * 10.0 ** exponents.astype(dtype)
    return _best_step(
        problem,
        coordinates,
        tried,
        chord_steps + 1,
        lambda attempt, dampings: jax.vmap(attempt)(dampings),
    )


def _best_step(
    problem: LinearisedResiduals,
    coordinates: _Coordinates,
    dampings: Float[Array, " damping"],
    chord_steps: int,
    for_each: Callable[..., tuple[Array, ...]],
) -> DampedStep:
    theta, residual = problem.theta, problem.residual
    dampings = jnp.maximum(dampings, coordinates.least)
    slope = coordinates.pull_back(residual)

    def attempt(damping: Float[Array, ""]) -> tuple[Array, Array, Array]:
        solve = coordinates.solver(damping)

        def iterate(state: tuple[Array, ...], _: None) -> tuple[tuple, None]:
            z, current, best, lowest = state
            z = z - solve(coordinates.pull_back(current) + damping * z)
            current = problem.residuals(theta + coordinates.move(z))
            cost = current @ current
            lower = cost < lowest
            best, lowest = jnp.where(lower, z, best), jnp.where(lower, cost, lowest)
            return (z, current, best, lowest), None

        zero = coordinates.zero
        start = (zero, residual, zero, jnp.asarray(jnp.inf, zero.dtype))
        (_, _, best, lowest), _ = jax.lax.scan(iterate, start, length=chord_steps)
        linear_move = coordinates.move(solve(slope))
        gain = (problem.jacobian @ linear_move) @ residual
        gain += damping * (linear_move @ linear_move)
        return coordinates.move(best), lowest, gain

    moves, costs, gains = for_each(attempt, dampings)
    best, cost = jnp.argmin(costs), residual @ residual
    lower = costs[best] < cost
    return DampedStep(
        theta=jnp.where(lower, theta + moves[best], theta),
        # Where no damping lowers the cost all were too small.
        damping=jnp.where(lower, dampings[best], 100.0 * problem.damping),
        left=jnp.where(lower, costs[best] / cost, 1.0),
        promised=gains[0] / cost,
    )


def low_rank(
    jacobian: Float[Array, "residual parameter"], rank: int
) -> tuple[
    Float[Array, "residual direction"],
    Float[Array, " direction"],
    Float[Array, "parameter direction"],
]:
    """U, S, V of a random projection of the row space; exact up to its rank.

    The Jacobian of a trained network has a numerical rank of some tens, so one random
    projection captures it, and any damping costs nothing more.

    References:
        Halko, Martinsson and Tropp, SIAM Review 53, 2011.
    """
    basis = row_space(jacobian, rank)
    left, triangle = jnp.linalg.qr(jacobian @ basis)
    inner, scale, outer = jnp.linalg.svd(triangle)
    return left @ inner, scale, basis @ outer.T


def row_space(
    jacobian: Float[Array, "residual parameter"], rank: int
) -> Float[Array, "parameter direction"]:
    """Orthonormal directions of the parameters that matter, `rank` of them at most."""
    rows, columns = jacobian.shape
    if columns <= rank:
        return jnp.eye(columns, dtype=jacobian.dtype)
    # A random projection of the rows finds the directions that matter without the
    # decomposition of the whole Jacobian.
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (rank, rows))
    basis = (jnp.asarray(signs, jacobian.dtype) @ jacobian).T
    # By the Gram matrix, which is quicker than a QR here; twice, for the first pass
    # leaves what the rounding of a Gram matrix hides.
    for floor in (1e-11, 1e-15):
        values, vectors = jnp.linalg.eigh(basis.T @ basis)
        lengths = jnp.sqrt(jnp.maximum(values, floor * values[-1]))
        basis = basis @ vectors / lengths[None]
    return basis


def pointwise(
    function: Callable[[Float[Array, " parameter"], Scalar, State], State],
    theta: Float[Array, " parameter"],
    points: tuple[Float[Array, " point"], Float[Array, "point state"]],
    targets: Float[Array, "point value"],
    size: Float[Array, "*value"],
) -> tuple[Residuals, Float[Array, "residual parameter"]]:
    """Residuals of a regression at times and places, and their Jacobian at parameters.

    They are relative to the size of the targets, of which zero counts as one.
    """
    size = jnp.where(size > 0, size, 1.0)

    def scaled(theta: Float[Array, " parameter"], t: Scalar, y: State) -> State:
        return function(theta, t, y) / size

    def residuals(theta: Float[Array, " parameter"]) -> Float[Array, " residual"]:
        computed = jax.vmap(scaled, (None, 0, 0))(theta, *points)
        return (computed - targets / jnp.broadcast_to(size, targets.shape)).reshape(-1)

    jacobian = jax.vmap(jax.jacrev(scaled), (None, 0, 0))(theta, *points)
    return residuals, jacobian.reshape(-1, theta.shape[0])
