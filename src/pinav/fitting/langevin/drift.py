r"""The drift given the diffusion, by causal generalised least squares.

Row n of $L^{-1}(\Delta - m)$ is the innovation of the position $y_{n+1}$ given all
before it, so that columns at past positions are legitimate in whitened rows although
these positions hold the same errors and the same blur as the increments.
"""

import dataclasses
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import on_device
from pinav.dynamics import OverdampedSwimmer
from pinav.fitting.engine.evidence_fit import EvidenceFit, evidence_fit
from pinav.fitting.engine.local_model import ParametricModel
from pinav.fitting.engine.problem import FullStep, Step
from pinav.fitting.environments.kernels import MOST_WEIGHTS, OFTEN
from pinav.fitting.environments.refinement import Refinement, iterate_refined
from pinav.fitting.evidence.evidence import LinearisedObservations
from pinav.fitting.evidence.hyperparameter_uncertainty import mix_shapes
from pinav.fitting.evidence.quadratic import Parameters
from pinav.fitting.evidence.weights import GaussianWeights
from pinav.fitting.langevin.covariance import TridiagonalFactor, whiten
from pinav.fitting.langevin.increments import Increments, Padding, Relation
from pinav.fitting.least_squares import TANGENTS, Regression, Slopes
from pinav.forces import KernelTensor
from pinav.trajectories import Trajectories


class WhitenedIncrements(eqx.Module):
    r"""Innovations as residuals of a model of the drift, linear in it.

    Each of them has a second residual: its square tells of the variance of the step,
    which depends on the slope of the drift. About a belief, $r^2/V - 1$ less the change
    of $\log V$ has the variance 2.

    Attributes:
        increments: positions from the reference.
        targets: increments less all of their mean that is not the model's [L].
        gains: see `Transition`.
        widening: derivatives of the logarithm of the variance by the same.
        excess: what the squares say of that logarithm, beside what is the model's.
        diffusion: D along each axis at the start of each increment [L² T⁻¹].
        factor: root of their covariance.
        surplus: sum of the squares of the second residuals at the belief.
        groups: the group of each axis whose diffusion is learned: what the squares say
            of all variances of a group alike is told by its diffusion; None where it
            is known.
    """

    increments: Increments
    targets: Float[Array, "increment dim"]
    gains: Float[Array, "increment dim feature"]
    widening: Float[Array, "increment dim feature"]
    excess: Float[Array, "increment dim"]
    diffusion: Float[Array, "increment dim"]
    factor: TridiagonalFactor
    padding: Padding
    surplus: Float[Array, ""]
    groups: Float[Any, "axis group"] | None

    @property
    def log_determinant(self) -> float:
        r"""$\log\det$ of the change from innovations to displacements.

        Less what the second residuals add to the density at the belief: they tell of
        the drift, and are no data of their own.
        """
        added = self.increments.steps.size * np.log(2 * np.pi) + self.surplus
        return float(self.factor.log_determinant - added)

    def __call__(self, model: OverdampedSwimmer) -> Float[Array, " residual"]:
        """Predicted less observed innovations, of variance one."""

        def predict(row: Row) -> tuple[Array, Array]:
            return _predict(model, row)

        means, widths = jax.lax.map(predict, self._rows, batch_size=AT_ONCE)
        return self._stack(means - self.targets, widths - self.excess)

    def linearise(self, parametric: ParametricModel, theta: Parameters) -> Slopes:
        """The innovations, and their slopes by the weights of the model."""
        return jax.tree.map(
            np.asarray, _linearise_innovations(self, parametric, on_device(theta))
        )

    def slopes(
        self, parametric: ParametricModel, theta: Float[Array, " parameter"]
    ) -> Float[Array, "residual parameter"]:
        """The slopes, of an increment after the other and then whitened."""

        def at(row: Row) -> tuple[Array, Array]:
            return jax.jacrev(lambda theta: _predict(parametric(theta), row))(theta)

        columns = jax.lax.map(at, self._rows, batch_size=FEW)
        columns = jax.tree.map(lambda each: jnp.moveaxis(each, 2, 0), columns)

        def stack(both: tuple[Array, Array]) -> Float[Array, " residual"]:
            return self._stack(*both)

        return jax.lax.map(stack, columns, batch_size=TANGENTS).T

    @property
    def _rows(self) -> "Row":
        rows = self.increments
        times, positions = jnp.asarray(rows.times), jnp.asarray(rows.positions)
        return times, positions, self.diffusion, self.gains, self.widening

    def _stack(
        self,
        means: Float[Array, "increment dim"],
        widths: Float[Array, "increment dim"],
    ) -> Float[Array, " residual"]:
        padded = self.padding.pad(means) * self.padding.mask[..., None]
        white = self.padding.flatten(whiten(self.factor, padded))
        widths = without_level(widths, self.groups) / np.sqrt(2.0)
        return jnp.concatenate([white.reshape(-1), widths.reshape(-1)])

    def in_time(
        self, residuals: Float[np.ndarray, " residual"]
    ) -> list[Float[np.ndarray, "_ channel"]]:
        """Innovations of each trajectory in the order of time."""
        return self.increments.in_time(residuals[: self.increments.steps.size])


def without_level(
    widths: Float[Array, "increment dim"],
    groups: Float[Any, "axis group"] | None,
) -> Float[Array, "increment dim"]:
    """Logarithms of variances less their mean over each group of axes."""
    if groups is None:
        return widths
    shares = groups / groups.sum(axis=0, keepdims=True)
    return widths - (widths.mean(axis=0) @ shares @ groups.T)[None]


Row = tuple[Array, Array, Array, Array, Array]
"""Time, position, diffusion, gains and widening of an increment."""

AT_ONCE, FEW = 4096, 256
"""Increments whose transitions are computed at once, and their slopes by weights."""


@eqx.filter_jit
def _linearise_innovations(
    rows: WhitenedIncrements,
    parametric: ParametricModel,
    theta: Float[Array, " parameter"],
) -> tuple[Float[Array, " residual"], Float[Array, "residual parameter"]]:
    return rows(parametric(theta)), rows.slopes(parametric, theta)


def _predict(model: OverdampedSwimmer, row: Row) -> tuple[Array, Array]:
    """Mean and log variance of an increment, beside what no model changes."""
    time, x, diffusion, gains, widening = row
    features = _features(lambda x: model(time, x), x, diffusion)
    return gains @ features, widening @ features


def _features(
    field: Any, x: Float[Array, " dim"], diffusion: Float[Array, " dim"]
) -> Float[Array, " feature"]:
    r"""A field $v$, its slopes $\partial_i v_j$, and $\sum_i D_i \partial_i^2 v_j$."""

    def along(unit: Array) -> tuple[Array, Array]:
        def slope(x: Array) -> Array:
            return jax.jvp(field, (x,), (unit,))[1]

        return jax.jvp(slope, (x,), (unit,))

    slopes, bends = jax.vmap(along)(jnp.eye(x.shape[0], dtype=x.dtype))
    return jnp.concatenate([field(x), slopes.ravel(), diffusion @ bends])


class Transition(eqx.Module):
    r"""The step from one observation to the next, the drift linearised at its start.

    With the slope $A = \tau \nabla v$ of the drift $v$, the functions
    $\varphi_1(A) = A^{-1}(e^A - 1)$ and $\varphi_2(A) = A^{-2}(e^A - 1 - A)$, and
    $(Lv)_j = \sum_i D_i\,\partial_i^2 v_j$, the mean of the increment is
    $\tau\varphi_1 v + \tau^2\varphi_2 L v$ and its covariance
    $2\tau\int_0^1 e^{As} D e^{A^\top s}\,ds$: exact for linear drifts, of second order
    for others. A diffusion that varies adds
    $\tfrac12\tau\,(v\cdot\nabla + \sum_i D_i\partial_i^2) D / D$ to the variance,
    relative to it.

    Attributes:
        gains: derivatives of the mean by $v$, its slopes and $Lv$.
        offsets: the mean less what these make of the swimmer, to first order [L].
        widening: derivatives of the logarithm of the variance by the same.
        widths: what these make of the swimmer.
        means: of each increment [L].
        factors: of its variance $2 D_i \tau$.
        kept: share of a displacement along each axis that is left after it.
        slopes: of the logarithm of these, the mean over the axes of each group, by
            level and weights of the group.

    References:
        Shoji and Ozaki, Biometrika 85, 240 (1998).
    """

    gains: Float[Array, "increment dim feature"]
    offsets: Float[Array, "increment dim"]
    widening: Float[Array, "increment dim feature"]
    widths: Float[Array, "increment dim"]
    means: Float[Array, "increment dim"]
    factors: Float[Array, "increment dim"]
    kept: Float[Array, "increment dim"]
    slopes: Float[Array, "increment group parameter"]

    @classmethod
    def of_short_steps(
        cls, increments: Increments, tensor: KernelTensor
    ) -> "Transition":
        """Short steps, as of Euler and Maruyama, beside a constant diffusion."""
        count, dim = increments.steps.shape
        groups, kernels = tensor.weights.shape
        gains = np.zeros((count, dim, 2 * dim + dim * dim))
        gains[:, :, :dim] = increments.intervals[:, None, None] * np.eye(dim)
        none = jnp.zeros((count, dim))
        slopes = jnp.zeros((count, groups, 1 + kernels))
        return cls(
            gains=jnp.asarray(gains),
            offsets=none,
            widening=jnp.zeros_like(gains),
            widths=none,
            means=none,
            factors=none + 1.0,
            kept=none + 1.0,
            slopes=slopes,
        )


STEEPEST = 3.0
"""Largest slope of the drift, times the interval, that is believed: where there are
hardly any data the slope of a first guess is nothing to go by."""

LARGEST_MEAN, FACTORS = 1.0, (0.05, 3.0)
"""Largest part of a mean by the curvature of the drift, in steps by diffusion, and
factors of a variance that are believed."""

TERMS = 18
"""Of the series of a matrix function, which is then exact to 1e-8 at `STEEPEST`."""


@eqx.filter_jit
def transitions(
    swimmer: OverdampedSwimmer,
    tensor: KernelTensor,
    increments: Increments,
    relation: Relation,
) -> Transition:
    """The steps that belong to a swimmer, at positions from the reference."""

    def at(row: tuple[Array, Array, Array]) -> tuple[Array, ...]:
        time, x, interval = row
        model = relation.swimmer_in(swimmer, tensor)
        diffusion = tensor.diagonal(x)

        def features_beside(there: KernelTensor) -> Array:
            moved = relation.swimmer_in(swimmer, there)

            def drift(x: Array) -> Array:
                known = moved(time, x)
                return known + divergence(there, x) if relation.einstein else known

            return _features(drift, x, there.diagonal(x))

        def mean_of(features: Array) -> tuple[Array, Array]:
            mean = _mean(features, diffusion, interval)
            return mean, mean

        features = features_beside(tensor)
        gains, mean = jax.jacfwd(mean_of, has_aux=True)(features)
        of_model = _features(lambda x: model(time, x), x, diffusion)

        def logarithms(levels: Array, weights: Array) -> tuple[Array, Array]:
            there = KernelTensor(levels, weights, tensor.basis, tensor.groups)
            factors = _factor_of(features_beside(there), there, x, interval)
            each = jnp.log(factors)
            means = [each[np.array(axes)].mean() for axes in tensor.groups]
            return jnp.stack(means), factors

        by_numbers = jax.jacrev(logarithms, argnums=(0, 1), has_aux=True)
        (levels, weights), factors = by_numbers(tensor.levels, tensor.weights)
        # What the diffusion of another group changes is left to the next turn.
        alone = jnp.arange(len(tensor.groups))
        alone_levels, alone_weights = levels[alone, alone], weights[alone, alone]
        slopes = jnp.concatenate([alone_levels[:, None], alone_weights], axis=1)

        def log_factors(features: Array) -> Array:
            return jnp.log(_factor_of(features, tensor, x, interval))

        widening = jax.jacfwd(log_factors)(features)
        kept = jnp.diagonal(_series(_steepness(features, len(x), interval), 0))
        offset, width = mean - gains @ of_model, widening @ of_model
        return gains, offset, widening, width, mean, factors, kept, slopes

    rows = tuple(
        map(jnp.asarray, (increments.times, increments.positions, increments.intervals))
    )
    return Transition(*jax.lax.map(at, rows, batch_size=AT_ONCE))


def _steepness(
    features: Float[Array, " feature"], dim: int, interval: Array
) -> Float[Array, "dim dim"]:
    r"""$A$, no larger than is believed."""
    steepness = interval * features[dim:-dim].reshape(dim, dim).T
    size = jnp.linalg.norm(steepness + TINY)
    return steepness * STEEPEST / jnp.maximum(size, STEEPEST)


def _mean(
    features: Float[Array, " feature"],
    diffusion: Float[Array, " dim"],
    interval: Array,
) -> Float[Array, " dim"]:
    dim = diffusion.shape[0]
    steepness = _steepness(features, dim, interval)
    most = LARGEST_MEAN * jnp.sqrt(2 * diffusion * interval)
    change = interval**2 * _series(steepness, 2) @ features[-dim:]
    ahead = interval * _series(steepness, 1) @ features[:dim]
    return ahead + jnp.clip(change, -most, most)


def _factor_of(
    features: Float[Array, " feature"], tensor: KernelTensor, x: Array, interval: Array
) -> Float[Array, " dim"]:
    """Factors of the variance by the features of the drift."""
    dim, diffusion = x.shape[0], tensor.diagonal(x)
    steepness = _steepness(features, dim, interval)
    change = _features(tensor.diagonal, x, diffusion)
    ahead = features[:dim] @ change[dim:-dim].reshape(dim, dim)
    growth = 0.5 * interval * (ahead + change[-dim:]) / diffusion

    def widen(place: Array) -> Array:
        return _series(place * steepness, 0) ** 2 @ diffusion

    places = jnp.asarray(0.5 * (1 + PLACES), x.dtype)
    spread = jnp.asarray(0.5 * WEIGHTS, x.dtype) @ jax.vmap(widen)(places)
    return jnp.clip(spread / diffusion + growth, *FACTORS)


TINY = 1e-30
"""Added where a norm of zero would have no derivative."""

PLACES, WEIGHTS = np.polynomial.legendre.leggauss(6)
"""Of Gauss' and Legendre's rule between -1 and 1."""


def _series(matrix: Float[Array, "dim dim"], order: int) -> Float[Array, "dim dim"]:
    r"""$\sum_k A^k / (k + n)!$ of a matrix, its exponential at n = 0."""
    unit = jnp.eye(len(matrix), dtype=matrix.dtype)

    def term(total: Array, power: Array) -> tuple[Array, None]:
        return unit + matrix @ total / (power + order), None

    # A loop in the program, in place of one that writes it, compiles in a tenth.
    powers = jnp.arange(TERMS, 0, -1, dtype=matrix.dtype)
    total, _ = jax.lax.scan(term, unit, powers)
    return total / math.factorial(order)


def divergence(tensor: KernelTensor, x: Float[Array, " dim"]) -> Float[Array, " dim"]:
    r"""$\nabla\cdot D$ of a tensor along the axes of the coordinates."""

    def along(unit: Array) -> Array:
        return jax.jvp(tensor.diagonal, (x,), (unit,))[1]

    return jnp.diagonal(jax.vmap(along)(jnp.eye(x.shape[0], dtype=x.dtype)))


@eqx.filter_jit
def at_each(function: Any, *rows: Array) -> Array:
    """A function of positions at many of them."""
    return jax.vmap(function)(*rows)


def fit_force(
    swimmer: OverdampedSwimmer,
    residuals: WhitenedIncrements,
    noise: float | None,
    refine: Refinement | None,
    trajectories: Trajectories,
) -> tuple[EvidenceFit, Step]:
    """The force that explains residuals, and the step that led to it.

    Args:
        swimmer: its environment is made of kernels.
        residuals: of a model of the drift.
        noise: their standard deviation; estimated where it is None.
        refine: when kernels turn out too coarse.
        trajectories: around which they are laid.
    """

    def begin(model: OverdampedSwimmer, states: None = None) -> Regression:
        return force_problem(model, residuals, noise)

    problem, outcome, steps = iterate_refined(
        begin(swimmer), begin, refine, trajectories, max_iterations=1
    )
    fit = evidence_fit(problem, outcome, steps, not_finite=NOT_FINITE, advice={})
    return fit, steps[-1]


def force_problem(
    model: OverdampedSwimmer,
    residuals: WhitenedIncrements,
    noise: float | None,
) -> Regression:
    """The regression of a force; it is linear, and solved about no force."""
    environment: Any = model.environment
    # about zero no digits cancel
    zeros = jax.tree.map(jnp.zeros_like, environment.parameters)
    return Regression.of(
        eqx.tree_at(lambda m: m.environment.parameters, model, zeros),
        residuals,
        weights=lambda m: m.environment.parameters,
        weights_prior=GaussianWeights(environment.prior()),
        noise=noise,
        step_rule=FullStep(),
        is_linear=True,
        linearisation=residuals.linearise,
        log_determinant=residuals.log_determinant,
    )


NOT_FINITE = "its drift is not finite at the observed positions; check the known forces"


def mix_over_shapes(
    fit: EvidenceFit, visited: Float[np.ndarray, "place dim"]
) -> EvidenceFit:
    """The fit whose force is the mean over all shapes, with the bands of them all.

    Each of 200 shapes asks for a decomposition. Forces with more than a share `OFTEN`
    of `MOST_WEIGHTS` keep the best shape, and a normal distribution about it: so many
    weights are laid only where the data tell the shape.

    Args:
        fit: linear in its weights, with nothing else to learn.
        visited: observed positions [L], beyond which the bands are wide.
    """
    fit = eqx.tree_at(
        lambda f: f.posterior.visited, fit, visited, is_leaf=lambda x: x is None
    )
    weights = fit.linear.weights
    few = len(fit.posterior.mean) <= OFTEN * MOST_WEIGHTS
    if not (few and isinstance(weights, GaussianWeights)):
        return fit
    data = LinearisedObservations.of(fit.linear.quadratic)
    chosen, noise = fit.hyperparameters, fit.linear.noise
    mean, covariance = mix_shapes(data, weights.prior, chosen, noise)
    posterior = dataclasses.replace(fit.posterior, mean=mean, covariance=covariance)
    return dataclasses.replace(fit, posterior=posterior, model=posterior.model)
