r"""What the observations say of any force, linearised about a fit.

About the states of a fit whose force is $F_0$, another force $F$ changes the residuals
by $G\,(F - F_0)$ with the forces at the states: the response $G$ is computed once, and
then the evidence of any structure is a regression without dynamics, in milliseconds.
It is that of the fit to first order; the fit of the chosen structure has the last word.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int, PyTree

from pinav.arguments import Scalar, State, Vector, on_device
from pinav.dynamics import FixedStep
from pinav.fitting.engine.multiple_shooting import (
    StepDerivatives,
    eliminate,
    propagate,
)
from pinav.fitting.evidence.quadratic import Quadratic
from pinav.fitting.matching.objectives import Observations
from pinav.forces import AbstractForce, AbstractTerm, ConstantForce, forces_at
from pinav.forces.kernels import AbstractKernels

MOST_GROUPS = 100
"""Groups of steps of a trajectory, in each of which the force counts as constant."""

LEAST_EIGENVALUE = 1e-8
"""Directions of the forces that the data determine less than this, relative to the
best, are left out."""


class ForceResponse(eqx.Module):
    r"""Residuals as a function of the force.

    Attributes:
        rows: $R_i$ of each trajectory, from forces to independent data.
        targets: what the data ask of the change of the force.
        points: where the forces act [L].
        times: when [T].
        forces: $F_0$ there [L T⁻²].
        num_free: residuals less starts.
        squares: sum of squares that no force explains.
    """

    rows: Float[Array, "trajectory datum force"]
    targets: Float[Array, "trajectory datum"]
    points: Float[Array, "trajectory group dim"]
    times: Float[Array, "trajectory group"]
    forces: Float[Array, "trajectory group dim"]
    num_free: int = eqx.field(static=True)
    squares: float = eqx.field(static=True)

    @property
    def num_projected(self) -> int:
        """Data that count less than one each: the starts, and what was compressed."""
        return self.targets.size + 1 - self.num_free

    @property
    def least_noise(self) -> float:
        """Standard deviation of what no force explains; infinite where all is."""
        left = self.num_free - self.targets.size
        return float(np.sqrt(self.squares / left)) if left > 0 else np.inf

    def __call__(self, force: AbstractForce) -> Float[Array, " residual"]:
        """Residuals of another force, the last of them what no force explains."""
        changes = forces_at(force, self.times, self.points) - self.forces
        flat = changes.reshape(len(changes), -1)
        left = jnp.einsum("idf,if->id", self.rows, flat) + self.targets
        return jnp.append(left.reshape(-1), jnp.sqrt(self.squares))


def force_quadratic(
    force: AbstractForce,
    response: ForceResponse,
    weights: Callable[[Any], PyTree],
) -> Quadratic:
    """What the data say of the weights of a force that is linear in them.

    Args:
        force: its other numbers are held.
        response: of the data to forces.
        weights: picks the leaves from a force; it must not be made anew for each call,
            which would be compiled again.
    """
    normal = _weight_equations(force, response, weights)
    hessian, gradient, squares = map(np.asarray, normal)
    return _about_none(hessian, gradient, float(squares), response)


def term_quadratics(
    terms: Sequence[AbstractTerm],
    beside: tuple[AbstractTerm, ...],
    response: ForceResponse,
) -> list[Quadratic]:
    """What the data say of the weights of each of several terms, beside others.

    Args:
        terms: of one kind, with as many kernels each.
        beside: whose weights come first.
        response: of the data to forces.
    """
    quadratics: list[Quadratic] = []
    for some, stacked in _stacks(terms):
        equations = _term_equations(stacked, beside, response)
        hessians, gradients, squares = map(np.asarray, equations)
        quadratics += [
            _about_none(hessian, gradient, float(squares), response)
            for hessian, gradient, _ in zip(hessians, gradients, some, strict=False)
        ]
    return quadratics


def reduced_columns(
    terms: Sequence[AbstractTerm],
    root: Float[np.ndarray, "weight column"],
    response: ForceResponse,
) -> Float[np.ndarray, "term datum column"]:
    """Residuals by each direction of the weights that a root of their prior holds.

    Args:
        terms: of one kind, with as many kernels each.
        root: of the covariance of their weights.
        response: of the data to forces.
    """
    parts = [
        np.asarray(_reduced_columns(stacked, on_device(root), response))[: len(some)]
        for some, stacked in _stacks(terms)
    ]
    return np.concatenate(parts)


def _stacks(
    terms: Sequence[AbstractTerm],
) -> Iterator[tuple[Sequence[AbstractTerm], AbstractTerm]]:
    """Terms in groups, and each group as one term whose leaves are stacked.

    Always as many are stacked, so that lists of every length share a compilation.
    """
    for first in range(0, len(terms), AT_ONCE):
        some = terms[first : first + AT_ONCE]
        filled = [*some, *[some[-1]] * (AT_ONCE - len(some))]
        yield some, jax.tree.map(lambda *leaves: jnp.stack(leaves), *filled)


@eqx.filter_jit
def _reduced_columns(
    terms: AbstractTerm, root: Float[Array, "weight column"], response: ForceResponse
) -> Float[Array, "term datum column"]:
    return jax.lax.map(lambda one: _columns(one, response, _own_weights) @ root, terms)


def force_columns(
    kernels: AbstractKernels, response: ForceResponse
) -> Float[np.ndarray, "datum weight"]:
    """Residuals by each weight of kernels."""
    return np.asarray(_force_columns(kernels, response))


@eqx.filter_jit
def _force_columns(
    kernels: AbstractKernels, response: ForceResponse
) -> Float[Array, "datum weight"]:
    return _columns(kernels, response, _own_weights)


def residuals_of_none(response: ForceResponse) -> Float[np.ndarray, " datum"]:
    """Residuals of no force."""
    return np.asarray(_offset(response))


AT_ONCE = 32
"""Terms whose equations are computed in one call."""


def _about_none(
    hessian: Float[np.ndarray, "weight weight"],
    gradient: Float[np.ndarray, " weight"],
    squares: float,
    response: ForceResponse,
) -> Quadratic:
    """Normal equations about no weights as a quadratic."""
    return Quadratic(
        point=np.zeros(len(gradient)),
        hessian=hessian,
        gradient=gradient,
        squares=squares + response.squares,
        num_free=response.num_free,
        log_determinant=0.0,
    )


@eqx.filter_jit
def _weight_equations(
    force: AbstractForce, response: ForceResponse, weights: Callable[[Any], PyTree]
) -> tuple[Float[Array, "weight weight"], Float[Array, " weight"], Float[Array, ""]]:
    """Normal equations of the weights, about none."""
    columns, offset = _columns(force, response, weights), _offset(response)
    return columns.T @ columns, columns.T @ offset, offset @ offset


@eqx.filter_jit
def _term_equations(
    terms: AbstractTerm, beside: tuple[AbstractTerm, ...], response: ForceResponse
) -> tuple[
    Float[Array, "term weight weight"], Float[Array, "term weight"], Float[Array, ""]
]:
    """Normal equations of the weights of stacked terms, each beside the others."""
    offset = _offset(response)
    others = [_columns(term, response, _own_weights) for term in beside]
    kept = jnp.concatenate([jnp.zeros((len(offset), 0)), *others], axis=1)
    among, along = kept.T @ kept, kept.T @ offset

    def one(term: AbstractTerm) -> tuple[Array, Array]:
        columns = _columns(term, response, _own_weights)
        cross, alone = kept.T @ columns, columns.T @ columns
        hessian = jnp.block([[among, cross], [cross.T, alone]])
        return hessian, jnp.concatenate([along, columns.T @ offset])

    hessians, gradients = jax.lax.map(one, terms)
    return hessians, gradients, offset @ offset


def _own_weights(term: AbstractTerm | AbstractKernels) -> PyTree:
    return term.weights


def _columns(
    force: AbstractForce, response: ForceResponse, weights: Callable[[Any], PyTree]
) -> Float[Array, "datum weight"]:
    """Residuals by each weight of a force that is linear in them."""

    def at(leaves: list[Array], t: Scalar, x: Vector) -> Vector:
        placed = eqx.tree_at(lambda f: jax.tree.leaves(weights(f)), force, leaves)
        return placed(t, x, jnp.zeros_like(x))

    zero = [jnp.zeros_like(leaf) for leaf in jax.tree.leaves(weights(force))]
    slopes = jax.vmap(jax.vmap(jax.jacrev(at), (None, 0, 0)), (None, 0, 0))
    parts = slopes(zero, response.times, response.points)
    shape = response.points.shape
    basis = jnp.concatenate([part.reshape(*shape, -1) for part in parts], axis=-1)
    basis = basis.reshape(len(basis), -1, basis.shape[-1])
    columns = jnp.einsum("idf,ifw->idw", response.rows, basis)
    return columns.reshape(-1, columns.shape[-1])


def _offset(response: ForceResponse) -> Float[Array, " datum"]:
    """Residuals of no force."""
    flat = response.forces.reshape(len(response.forces), -1)
    offset = response.targets - jnp.einsum("idf,if->id", response.rows, flat)
    return offset.reshape(-1)


def force_response(
    model: Any,
    states: Float[Array, "trajectory time state"],
    observations: Observations,
    solver: FixedStep,
    dim: int,
) -> ForceResponse:
    """The response of the observations to a change of the force of a fitted model.

    Args:
        model: the fitted model.
        states: its smoothed states.
        observations: the data.
        solver: steps between samples.
        dim: dimension of space.
    """
    group, groups = _grouped(states.shape[1] - 1)
    hessians, gradients, squares = _normal_equations(
        model, states, observations, solver, group, groups, dim
    )
    rows, targets, left = _compress(np.asarray(hessians), np.asarray(gradients))
    times, places = np.asarray(observations.times), np.asarray(states)[..., :dim]
    points = _means((places[:, 1:] + places[:, :-1]) / 2, group, groups)
    when = _means((times[:, 1:, None] + times[:, :-1, None]) / 2, group, groups)[..., 0]
    count = int(np.asarray(observations.observed).sum())
    return ForceResponse(
        rows=on_device(rows),
        targets=on_device(targets),
        points=on_device(points),
        times=on_device(when),
        forces=forces_at(model.environment, when, points),
        num_free=count - states.shape[0] * states.shape[2],
        squares=max(float(np.sum(np.asarray(squares)) - left), 0.0),
    )


def _grouped(steps: int) -> tuple[Int[np.ndarray, " step"], int]:
    """The group of each step, and their number."""
    size = -(-steps // MOST_GROUPS)
    return np.arange(steps) // size, -(-steps // size)


def _means(
    values: Float[np.ndarray, "trajectory step channel"],
    group: Int[np.ndarray, " step"],
    groups: int,
) -> Float[np.ndarray, "trajectory group channel"]:
    """Mean over the steps of each group."""
    fractions = np.eye(groups)[group]
    return np.einsum("isc,sg->igc", values, fractions / fractions.sum(axis=0)[None])


@eqx.filter_jit
def _normal_equations(
    model: Any,
    states: Float[Array, "trajectory time state"],
    observations: Observations,
    solver: FixedStep,
    group: Int[ArrayLike, " step"],
    groups: int,
    dim: int,
) -> tuple[
    Float[Array, "trajectory force force"],
    Float[Array, "trajectory force"],
    Float[Array, " trajectory"],
]:
    """Of each trajectory, by the forces in each group of steps, starts eliminated."""
    spread = jax.nn.one_hot(group, groups, dtype=states.dtype)

    def step(push: Vector, y: State, t0: Scalar, t1: Scalar) -> tuple[State, State]:
        force = model.environment + ConstantForce(push)
        moved = eqx.tree_at(lambda m: m.environment, model, force)
        end = solver.looped_step(moved, y, t0, t1)
        return end, end

    def one(inputs: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array]:
        states, times, data, observed = inputs
        slopes = jax.vmap(jax.jacfwd(step, (0, 1), has_aux=True), (None, 0, 0, 0))
        at = (jnp.zeros(dim), states[:-1], times[:-1], times[1:])
        (by_force, by_state), ends = slopes(*at)
        columns = jnp.einsum("ksd,kg->ksgd", by_force, spread)
        columns = columns.reshape(*by_force.shape[:2], -1)
        steps = StepDerivatives(columns, by_state, ends)
        reach = propagate(steps, states).columns
        residuals = states + reach[..., -1] - data
        rows = jnp.concatenate([reach[..., :-1], residuals[..., None]], axis=2)
        rows = jnp.where(observed[..., None], rows, 0.0).reshape(-1, rows.shape[2])
        rest, _, _ = eliminate(rows, groups * dim, states.shape[1])
        total = rest.T @ rest
        return total[:-1, :-1], total[:-1, -1], total[-1, -1]

    data = observations
    return jax.lax.map(one, (states, data.times, data.states, data.observed))


def _compress(
    hessians: Float[np.ndarray, "trajectory force force"],
    gradients: Float[np.ndarray, "trajectory force"],
) -> tuple[
    Float[np.ndarray, "trajectory datum force"],
    Float[np.ndarray, "trajectory datum"],
    float,
]:
    """Rows and targets with the same normal equations, as few as there can be."""
    values, vectors = np.linalg.eigh(hessians)
    least = LEAST_EIGENVALUE * values.max()
    keep = max(int((values > least).sum(axis=1).max()), 1)
    values, vectors = values[:, -keep:], vectors[:, :, -keep:]
    roots = np.sqrt(np.maximum(values, least))
    along = np.einsum("ifd,if->id", vectors, gradients)
    targets = np.where(values > least, along / roots, 0.0)
    rows = np.where(values > least, roots, 0.0)[:, :, None] * np.swapaxes(vectors, 1, 2)
    return rows, targets, float(np.sum(targets**2))
