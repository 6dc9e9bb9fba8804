r"""The drift given the diffusion: exact positions, or causal generalised least squares.

Row n of $L^{-1}(\Delta - m)$ is the innovation of the position $y_{n+1}$ given all
before it, so that columns at past positions are legitimate in whitened rows although
these positions hold the same errors and the same blur as the increments.

Without inertia $dX = (u + M F)\,dt + \sqrt{2D}\,dW$. From one observation to the next
an increment is nearly normal about the drift: divided by $\sqrt{\Delta t}$, all have
the variance 2D, and kernels are linear in their weights. So the evidence chooses prior
and diffusion as `fit_bayes` chooses prior and noise.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.dynamics import OverdampedSwimmer
from pinav.fitting.engine.evidence_fit import EvidenceFit, evidence_fit
from pinav.fitting.engine.posterior import Estimate
from pinav.fitting.engine.problem import FullStep, Step
from pinav.fitting.environments.kernels import MOST_WEIGHTS, OFTEN
from pinav.fitting.environments.refinement import Refinement, iterate_refined
from pinav.fitting.evidence.evidence import LinearisedObservations
from pinav.fitting.evidence.hyperparameter_uncertainty import mix_shapes
from pinav.fitting.evidence.weights import GaussianWeights
from pinav.fitting.langevin.covariance import TridiagonalFactor, whiten
from pinav.fitting.langevin.increments import Increments, Padding, Relation
from pinav.fitting.least_squares import Regression
from pinav.forces import KernelTensor
from pinav.trajectories import Trajectories


class WhitenedIncrements(eqx.Module):
    """Innovations as residuals of a model of the drift.

    Attributes:
        increments: positions from the reference.
        targets: increments less all of their mean that is not the model's [L].
        factor: root of their covariance.
    """

    increments: Increments
    targets: Float[Array, "increment dim"]
    factor: TridiagonalFactor
    padding: Padding

    @property
    def log_determinant(self) -> float:
        r"""$\log\det$ of the change from innovations to displacements."""
        return float(self.factor.log_determinant)

    def __call__(self, model: OverdampedSwimmer) -> Float[Array, " residual"]:
        """Predicted less observed innovations, of variance one."""
        rows = self.increments
        drift = jax.vmap(model)(jnp.asarray(rows.times), jnp.asarray(rows.positions))
        means = drift * jnp.asarray(rows.intervals)[:, None]
        residuals = self.padding.pad(means - self.targets)
        whitened = whiten(self.factor, residuals * self.padding.mask[..., None])
        return self.padding.flatten(whitened).reshape(-1)

    def in_time(
        self, residuals: Float[np.ndarray, " residual"]
    ) -> list[Float[np.ndarray, "_ channel"]]:
        """Residuals of each trajectory in the order of time."""
        return self.increments.in_time(residuals)


class SecondOrder(eqx.Module):
    r"""What the curvature of drift and diffusion adds within one step.

    With $\mathcal L = v\cdot\nabla + \sum_i D_i\partial_i^2$ the mean has
    $\tfrac12\tau^2\mathcal L v$ more, and the variance is
    $2D_i\tau[1 + \tau(\mathcal L D_i/2D_i + \partial_i v_i)]$.

    Attributes:
        means: of each increment [L].
        factors: of its variance.
        slopes: of the logarithm of these, the mean over the axes of each group, by
            level and weights of the group.
    """

    means: Float[Array, "increment dim"]
    factors: Float[Array, "increment dim"]
    slopes: Float[Array, "increment group parameter"]

    @classmethod
    def none(cls, increments: Increments, tensor: KernelTensor) -> "SecondOrder":
        """Steps that are short."""
        count, dim = increments.steps.shape
        groups, kernels = tensor.weights.shape
        slopes = jnp.zeros((count, groups, 1 + kernels))
        return cls(jnp.zeros((count, dim)), jnp.ones((count, dim)), slopes)


LARGEST_MEAN, FACTORS = 0.3, (0.6, 1.6)
"""Largest correction of a mean, in steps by diffusion, and of a variance: where there
are hardly any data the curvature of a first guess is nothing to go by."""

AT_ONCE = 4096
"""Increments whose corrections are computed at once."""


@eqx.filter_jit
def second_order(
    swimmer: OverdampedSwimmer,
    tensor: KernelTensor,
    increments: Increments,
    relation: Relation,
) -> SecondOrder:
    """Corrections for steps that are not short, at positions from the reference."""

    def at(row: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        time, x, interval = row

        def logarithms(levels: Array, weights: Array) -> tuple[Array, Any]:
            there = KernelTensor(levels, weights, tensor.basis, tensor.groups)
            mean, factors = _terms(swimmer, there, relation, time, x, interval)
            each = jnp.log(factors)
            means = [each[np.array(axes)].mean() for axes in tensor.groups]
            return jnp.stack(means), (mean, factors)

        by_numbers = jax.jacrev(logarithms, argnums=(0, 1), has_aux=True)
        (levels, weights), terms = by_numbers(tensor.levels, tensor.weights)
        # What the diffusion of another group changes is left to the next turn.
        alone = jnp.arange(len(tensor.groups))
        alone_levels, alone_weights = levels[alone, alone], weights[alone, alone]
        slopes = jnp.concatenate([alone_levels[:, None], alone_weights], axis=1)
        return (*terms, slopes)

    rows = tuple(
        map(jnp.asarray, (increments.times, increments.positions, increments.intervals))
    )
    return SecondOrder(*jax.lax.map(at, rows, batch_size=AT_ONCE))


def _terms(
    swimmer: OverdampedSwimmer,
    tensor: KernelTensor,
    relation: Relation,
    time: Array,
    x: Array,
    interval: Array,
) -> tuple[Array, Array]:
    """Correction of the mean and factors of the variance of one increment."""
    model = relation.swimmer_in(swimmer, tensor)
    units = jnp.eye(x.shape[0], dtype=x.dtype)

    def drift(x: Array) -> Array:
        known = model(time, x)
        return known + divergence(tensor, x) if relation.einstein else known

    def generator(field: Any) -> tuple[Array, Array]:
        def along(unit: Array) -> tuple[Array, Array]:
            def slope(x: Array) -> Array:
                return jax.jvp(field, (x,), (unit,))[1]

            return jax.jvp(slope, (x,), (unit,))

        slopes, bends = jax.vmap(along)(units)
        return drift(x) @ slopes + diffusion @ bends, jnp.diagonal(slopes)

    diffusion = tensor.diagonal(x)
    change, strain = generator(drift)
    growth, _ = generator(tensor.diagonal)
    most = LARGEST_MEAN * jnp.sqrt(2 * diffusion * interval)
    mean = jnp.clip(0.5 * interval**2 * change, -most, most)
    excess = interval * (0.5 * growth / diffusion + strain)
    return mean, jnp.clip(1 + excess, *FACTORS)


def divergence(tensor: KernelTensor, x: Float[Array, " dim"]) -> Float[Array, " dim"]:
    r"""$\nabla\cdot D$ of a tensor along the axes of the coordinates."""

    def along(unit: Array) -> Array:
        return jax.jvp(tensor.diagonal, (x,), (unit,))[1]

    return jnp.diagonal(jax.vmap(along)(jnp.eye(x.shape[0], dtype=x.dtype)))


@eqx.filter_jit
def at_each(function: Any, *rows: Array) -> Array:
    """A function of positions, or of times and positions, at many of them."""
    return jax.vmap(function)(*rows)


def divergences(
    tensor: KernelTensor, positions: Float[Array, "increment dim"]
) -> Float[Array, "increment dim"]:
    """The divergence at many positions."""
    return at_each(eqx.Partial(divergence, tensor), positions)


def fit_force(
    swimmer: OverdampedSwimmer,
    residuals: Increments | WhitenedIncrements,
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
    residuals: Increments | WhitenedIncrements,
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
        log_determinant=residuals.log_determinant,
    )


NOT_FINITE = "its drift is not finite at the observed positions; check the known forces"


def diffusion_of(step: Step) -> Estimate:
    """Diffusion from the noise; its deviation from the degrees of freedom left."""
    variance = step.hyperparameters.noise**2
    # Each direction that the data determine takes one observation from the variance.
    left = max(step.quadratic.num_free - step.num_determined, 1.0)
    return Estimate(variance / 2, variance / 2 * float(np.sqrt(2 / left)))


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
