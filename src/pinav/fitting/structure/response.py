r"""Response of the observations to any force, linearised about a fit.

About the states of a fit whose force is $F_0$, another force $F$ changes the residuals
by $G\,(F - F_0)$ with the forces at the states: the response $G$ is computed once, and
then the evidence of any structure is a regression without dynamics, in milliseconds.
It is that of the fit to first order; the fit of the chosen structure has the last word.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int, PyTree

from pinav.arguments import Scalar, State, Vector, on_device
from pinav.dynamics import FixedStep
from pinav.fitting.engine.local_model import ParametricModel, ravel_model
from pinav.fitting.engine.multiple_shooting import StepDerivatives, eliminate, propagate
from pinav.fitting.evidence.quadratic import Parameters, Quadratic
from pinav.fitting.least_squares import Slopes
from pinav.fitting.matching.state import Observations
from pinav.forces import AbstractForce, AbstractTerm, ConstantForce, forces_at
from pinav.forces.kernel_mixtures import AbstractKernelSum
from pinav.forces.kernels import AbstractKernels

MOST_GROUPS = 100
"""Groups of steps of a trajectory, in each of which the force counts as constant."""

LEAST_EIGENVALUE = 1e-8
"""Directions of the forces that the data determine less than this, relative to the
best, are left out."""

Linear = AbstractTerm | AbstractKernels
"""A force that is linear in its weights."""


class ForceResponse(eqx.Module):
    r"""Residuals as a function of the force.

    Forces are computed term by term, and what the data say of them outside of compiled
    functions: so all structures, and data of every number, share the programs of terms.

    Attributes:
        rows: $R_i$ of each trajectory, from forces to independent data.
        forces: $F_0$ there [L T⁻²].
    """

    rows: Float[np.ndarray, "trajectory datum force"]
    targets: Float[np.ndarray, "trajectory datum"]
    points: Float[Array, "trajectory group dim"]
    times: Float[Array, "trajectory group"]
    forces: Float[np.ndarray, "trajectory group dim"]
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

    @property
    def residuals_of_none(self) -> Float[np.ndarray, " datum"]:
        """Residuals of no force, of all trajectories in a row."""
        return self.targets.ravel() - self.change(self.forces)

    def __call__(self, force: AbstractForce) -> Float[Array, " residual"]:
        """Residuals of another force, the last of them what no force explains."""
        changes = forces_at(force, self.times, self.points) - self.forces
        flat = changes.reshape(len(changes), -1)
        left = jnp.einsum("idf,if->id", self.rows, flat) + self.targets
        return jnp.append(left.reshape(-1), jnp.sqrt(self.squares))

    def change(
        self, forces: Float[np.ndarray, "trajectory group dim *all"]
    ) -> Float[np.ndarray, " datum *all"]:
        """Change of the residuals by forces."""
        others = forces.shape[3:]
        flat = forces.reshape(len(forces), self.rows.shape[2], -1)
        return (self.rows @ flat).reshape(-1, *others)

    def linearise(self, parametric: ParametricModel, theta: Parameters) -> Slopes:
        """Residuals of a sum of terms, and their slopes by its parameters."""
        parts = [_slopes(term, self) for term in parametric.at(theta).terms]
        forces = sum(part[0] for part in parts) - self.forces
        slopes = np.concatenate([part[1] for part in parts], axis=-1)
        residuals = self.change(forces) + self.targets.ravel()
        rows = np.vstack([self.change(slopes), np.zeros(len(theta))])
        return np.append(residuals, np.sqrt(self.squares)), rows


def parts_of(kernels: Any) -> tuple[Linear, ...]:
    """The forces of kernels that add up; one where there is no sum."""
    parts: Any = (kernels,)
    if isinstance(kernels, AbstractKernelSum):
        parts = kernels.parts
    return parts


def columns(
    force: Linear, response: ForceResponse
) -> Float[np.ndarray, "datum weight"]:
    """Residuals by each weight of a force that is linear in them."""
    return slopes(force, response)[:, : force.weights.size]


def slopes(force: Linear, response: ForceResponse) -> Float[np.ndarray, "datum number"]:
    """Residuals by the weights of a force, which come first, and by its geometry."""
    return response.change(_slopes(force, response)[1])


def force_quadratic(parts: Sequence[Linear], response: ForceResponse) -> Quadratic:
    """Quadratic form of the data in the weights of forces that act together."""
    rows = np.concatenate([columns(part, response) for part in parts], axis=1)
    offset = response.residuals_of_none
    return Quadratic(
        point=np.zeros(rows.shape[1]),
        hessian=rows.T @ rows,
        gradient=rows.T @ offset,
        squares=float(offset @ offset) + response.squares,
        num_free=response.num_free,
        log_determinant=0.0,
    )


def forces_by_weight(
    terms: Sequence[AbstractTerm], response: ForceResponse
) -> Iterator[Float[np.ndarray, "trajectory group dim weight"]]:
    """Forces by each weight of each of several terms at the points of the data.

    Always as many are computed in one call, so that lists of every length share a
    compilation.
    """
    for first in range(0, len(terms), AT_ONCE):
        some = terms[first : first + AT_ONCE]
        filled = [*some, *[some[-1]] * (AT_ONCE - len(some))]
        stacked = jax.tree.map(_stack, *filled)
        forces = np.asarray(_forces_by_weight(stacked, response.times, response.points))
        yield from forces[: len(some)]


AT_ONCE = 32
"""Terms whose forces are computed in one call."""


def _stack(*leaves: ArrayLike) -> Array:
    return on_device(np.stack([np.asarray(leaf) for leaf in leaves]))


def _slopes(
    force: Linear, response: ForceResponse
) -> tuple[
    Float[np.ndarray, "trajectory group dim"],
    Float[np.ndarray, "trajectory group dim number"],
]:
    """A force at the points of the data, and its slopes by its weights and geometry.

    Weights come first, as they do in every such force.
    """
    by_numbers = ravel_model(force, _numbers)
    made = _forces_and_slopes(*by_numbers, response.times, response.points)
    forces, slopes = map(np.asarray, made)
    return forces, slopes


def _numbers(force: Linear) -> PyTree:
    is_term = isinstance(force, AbstractTerm)
    return (force.weights, force.geometry) if is_term else force.weights


@eqx.filter_jit
def _forces_and_slopes(
    parametric: ParametricModel,
    theta: Float[Array, " number"],
    times: Float[Array, "trajectory group"],
    points: Float[Array, "trajectory group dim"],
) -> tuple[
    Float[Array, "trajectory group dim"], Float[Array, "trajectory group dim number"]
]:
    def at(theta: Float[Array, " number"], t: Scalar, x: Vector) -> Any:
        force = parametric(theta)(t, x, jnp.zeros_like(x))
        return force, force

    by_numbers = jax.jacrev(at, has_aux=True)
    each = jax.vmap(jax.vmap(by_numbers, (None, 0, 0)), (None, 0, 0))
    slopes, forces = each(theta, times, points)
    return forces, slopes


@eqx.filter_jit
def _forces_by_weight(
    terms: AbstractTerm,
    times: Float[Array, "trajectory group"],
    points: Float[Array, "trajectory group dim"],
) -> Float[Array, "term trajectory group dim weight"]:
    """Forces of stacked terms by weight, in which they are linear."""

    def one(term: AbstractTerm) -> Float[Array, "trajectory group dim weight"]:
        def at(weights: Float[Array, " weight"], t: Scalar, x: Vector) -> Vector:
            placed = eqx.tree_at(lambda one: one.weights, term, weights)
            return placed(t, x, jnp.zeros_like(x))

        each = jax.vmap(jax.vmap(jax.jacrev(at), (None, 0, 0)), (None, 0, 0))
        return each(jnp.zeros_like(term.weights), times, points)

    return jax.lax.map(one, terms)


def force_response(
    model: Any,
    states: Float[Array, "trajectory time state"],
    observations: Observations,
    solver: FixedStep,
    dim: int,
) -> ForceResponse:
    """The response of the observations to a change of the force of a fitted model."""
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
        rows=rows,
        targets=targets,
        points=on_device(points),
        times=on_device(when),
        forces=np.asarray(forces_at(model.environment, when, points)),
        num_free=count - states.shape[0] * states.shape[2],
        squares=max(float(np.sum(np.asarray(squares)) - left), 0.0),
    )


def _grouped(steps: int) -> tuple[Int[np.ndarray, " step"], int]:
    size = -(-steps // MOST_GROUPS)
    return np.arange(steps) // size, -(-steps // size)


def group_means(
    values: Float[np.ndarray, "trajectory step channel"],
) -> Float[np.ndarray, "trajectory group channel"]:
    """Means over the steps of each group in which a force counts as constant."""
    return _means(values, *_grouped(values.shape[1]))


def _means(
    values: Float[np.ndarray, "trajectory step channel"],
    group: Int[np.ndarray, " step"],
    groups: int,
) -> Float[np.ndarray, "trajectory group channel"]:
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
    """Normal equations of each trajectory by force, starts eliminated."""
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
