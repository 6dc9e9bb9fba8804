r"""Diffusion and observation by their likelihood, given the drift.

A problem of the engine like any other: the gradient is exact, by the three bands of
the inverse; the Hessian is Whittle's information of each interval,
$\tfrac12\langle g g^\top\rangle_\omega$ with the derivatives g of
$\log S(\omega)$, $S = 2D(\tau - \tfrac T3(1 - \cos\omega)) + 2\sigma^2(1-\cos\omega)$.
So each step is one of Fisher's scoring, and the evidence chooses length and amplitude
of the prior of log D.

References:
    Whittle, Ark. Mat. 2, 423 (1953); Rasmussen and Williams, Gaussian Processes for
    Machine Learning (2006), section 3.4.
"""

from functools import reduce
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from pinav.fitting.engine.evidence_fit import DEFECT_TOLERANCE
from pinav.fitting.engine.local_model import (
    AbstractLocalModel,
    ConstantPriors,
    ParametricModel,
    PenalisedSquares,
    Prediction,
    States,
    parameter_names,
    ravel_model,
    selected_entries,
)
from pinav.fitting.engine.problem import AbstractProblem, AbstractStepRule, Move
from pinav.fitting.evidence.model_evidence import LinearFit
from pinav.fitting.evidence.quadratic import Parameters, Quadratic
from pinav.fitting.evidence.weights import AbstractWeights, GaussianWeights, NoWeights
from pinav.fitting.langevin.covariance import Tridiagonal, cut, increment_bands, score
from pinav.fitting.langevin.diffusion import ThermalMotion
from pinav.fitting.langevin.increments import LearnedObservation, Padding, Relation
from pinav.forces.priors import AbstractPrior, MixturePrior, StationaryPrior
from pinav.systems.priors import Normal

FREQUENCIES = 12
"""Points over half a turn at which Whittle's mean is taken; it is smooth."""

LONGEST = 2.0
"""Change of a logarithm in one step at most."""

NEGLIGIBLE = 0.01
"""Change of the log likelihood [nats] that ends the steps."""


class Fluctuations(eqx.Module):
    """Increments less their mean, and what is known of their variance.

    Attributes:
        residuals: increments less their mean, time first [L]; zero in the padding.
        offsets: of the logarithm of 2D over the increment, from the terms of second
            order at level and weights of zero.
        kept: share of a displacement that is left after each increment.
        design: derivatives of that logarithm by level and weights of each group.
    """

    residuals: Float[Array, "time track dim"]
    offsets: Float[Array, "time track dim"]
    kept: Float[Array, "time track dim"]
    intervals: Float[Array, "time track"]
    design: Float[Array, "increment group parameter"]
    padding: Padding


class DiffusionProblem(AbstractProblem):
    """The likelihood of thermal motion; see `AbstractProblem` for what is not here.

    Attributes:
        fluctuations: the increments about their mean.
    """

    fluctuations: Fluctuations
    parametric: ParametricModel
    theta: Parameters
    weights: AbstractWeights
    priors: ConstantPriors
    step_rule: AbstractStepRule
    names: tuple[str, ...]
    flat: Bool[np.ndarray, " parameter"]
    states: Float[Array, "trajectory time state"] | None = None
    tolerance: float = 0.05
    noise: float | None = 1.0
    first_noise: float = 1.0
    least_noise: float = 1e-12
    teacher: LinearFit | None = None
    visited: Float[np.ndarray, "place dim"] | None = None

    @classmethod
    def of(
        cls, motion: ThermalMotion, fluctuations: Fluctuations, relation: Relation
    ) -> "DiffusionProblem":
        """The problem that begins at a motion."""
        learn_diffusion, observation = relation.learn_diffusion, relation.observation
        varies = bool(motion.diffusion.weights.size) and learn_diffusion

        def constants(m: ThermalMotion) -> tuple:
            level = (m.diffusion.levels,) if learn_diffusion else ()
            observed = (m.log_odds, m.log_errors) if observation is not None else ()
            return level + observed

        def select(m: ThermalMotion) -> tuple:
            kernels = (m.diffusion.weights,) if varies else ()
            return kernels + constants(m)

        parametric, theta = ravel_model(motion, select)
        names = parameter_names(parametric, len(theta))
        return cls(
            fluctuations=fluctuations,
            parametric=parametric,
            theta=np.asarray(theta),
            weights=_weights(motion),
            priors=_priors(names, observation),
            step_rule=LimitedStep(),
            names=names,
            flat=selected_entries(parametric, len(theta), constants),
        )

    def linearise(self, theta: Parameters, states: States) -> AbstractLocalModel | None:
        data = self.fluctuations
        motion = self.parametric(jnp.asarray(theta))
        # Each learned leaf holds the places of its parameters, counted from one.
        marks = self.parametric.unravel(jnp.arange(1.0, len(theta) + 1.0))
        value = 0.0
        gradient, hessian = np.zeros(len(theta)), np.zeros((len(theta),) * 2)
        for group, axes in enumerate(motion.diffusion.groups):
            local = local_terms(motion, group, axes, data)
            terms = _group_terms(motion, group, local, data)
            value += float(terms.value)
            entries = _entries(marks, motion, group)
            kept = entries >= 0
            gradient[entries[kept]] += np.asarray(terms.gradient)[kept]
            block = np.ix_(entries[kept], entries[kept])
            hessian[block] += np.asarray(terms.information)[np.ix_(kept, kept)]
        if not (np.isfinite(value) and np.all(np.isfinite(gradient))):
            return None
        count, dim = data.padding.places.shape[0], data.residuals.shape[-1]
        quadratic = Quadratic(
            point=theta,
            hessian=hessian,
            gradient=-gradient,
            squares=-2 * value,
            num_free=count * dim,
            log_determinant=0.0,
        )
        return LocalLikelihood(quadratic)

    def flat_information(self) -> tuple[int, float]:
        count = self.fluctuations.padding.places.shape[0]
        total = count * self.fluctuations.residuals.shape[-1]
        return total, int(self.flat.sum()) * float(np.log(total))


class LocalLikelihood(AbstractLocalModel):
    """The likelihood about one point, to second order.

    Attributes:
        quadratic: minus twice its logarithm.
    """

    quadratic: Quadratic

    def predict(self, theta: Parameters) -> Prediction:
        """There are no residuals beside the quadratic."""
        return Prediction(jnp.zeros(0), None)

    def pull_back(self, residuals: Float[Array, "..."]) -> Parameters:
        return np.zeros(len(self.theta))

    def advance(self, mean: Parameters) -> None:
        """There are no states."""

    def defect(self, mean: Parameters, noise: float) -> float:
        """What a step still gains."""
        change = mean - self.theta
        gain = 0.5 * float(change @ self.quadratic.hessian @ change)
        return DEFECT_TOLERANCE * gain / NEGLIGIBLE


class LimitedStep(AbstractStepRule):
    """To the mean, unless a logarithm would change by more than `LONGEST`."""

    def __call__(self, cost: PenalisedSquares, mean: Parameters) -> Move:
        change = mean - cost.local.theta
        # Logarithms are learned: a long step would change a diffusion by orders of
        # magnitude.
        fraction = min(
            1.0, LONGEST / max(float(np.abs(change).max(initial=0.0)), 1e-300)
        )
        return Move(cost.local.theta + fraction * change, None, self)


class LocalTerms(eqx.Module):
    """What each increment says of the axes of one group.

    Attributes:
        by_log: its derivative by log D at the start of each increment.
        by_observation: by exposure and variance.
        information: of each on log D, exposure and variance: the upper half.
        pulled: its derivative by the mean along each axis of the group.
    """

    value: Float[Array, ""]
    by_log: Float[Array, " increment"]
    by_observation: Float[Array, "2"]
    information: Float[Array, "increment 6"]
    pulled: Float[Array, "increment axis"]


class GroupTerms(eqx.Module):
    """What the axes of one group say of level, weights, log odds and log error."""

    value: Float[Array, ""]
    gradient: Float[Array, " parameter"]
    information: Float[Array, "parameter parameter"]


@eqx.filter_jit
def local_terms(
    motion: ThermalMotion, group: int, axes: tuple[int, ...], data: Fluctuations
) -> LocalTerms:
    """The likelihood of one group of axes, increment by increment."""
    columns, padding = np.array(axes), data.padding
    levels, weights = motion.diffusion.levels, motion.diffusion.weights
    exposure, variance = motion.exposures[group], motion.variances[group]
    numbers = jnp.concatenate([levels[group][None], weights[group]])
    linear = padding.pad(data.design[:, group] @ numbers)[..., None]
    logs = linear + data.offsets[..., columns]
    mask = jnp.broadcast_to(padding.mask[..., None], (*padding.mask.shape, len(axes)))
    intervals = jnp.broadcast_to(data.intervals[..., None], mask.shape)

    def bands(logs: Array, exposure: Array, variance: Array) -> Tridiagonal:
        kept = data.kept[..., columns]
        local = increment_bands(jnp.exp(logs), intervals, exposure, variance, kept)
        return cut(local, mask)

    # The score of the bands is known in closed form; only its way back through the
    # bands is left to differentiation.
    matrix, chain = jax.vjp(bands, logs, exposure, variance)
    slope = score(matrix, data.residuals[..., columns] * mask)
    by_log, by_exposure, by_variance = chain(slope.by_bands)
    pairs = _whittle(jnp.exp(logs), intervals, exposure, variance)
    summed = jnp.stack([jnp.sum(one * mask, axis=2) for one in pairs], axis=-1)
    return LocalTerms(
        slope.value,
        padding.flatten(by_log.sum(axis=-1)),
        jnp.stack([by_exposure, by_variance]),
        padding.flatten(summed),
        padding.flatten(slope.pulled),
    )


@eqx.filter_jit
def _group_terms(
    motion: ThermalMotion, group: int, local: LocalTerms, data: Fluctuations
) -> GroupTerms:
    exposure, variance = motion.exposures[group], motion.variances[group]
    fraction = jnp.minimum(exposure / motion.interval, 1.0)
    scales = jnp.stack([exposure * (1 - fraction), variance])
    design = data.design[:, group]
    pairs = local.information
    both = (design * pairs[:, :1]).T @ design
    border = design.T @ pairs[:, 1:3] * scales[None]
    # Three sums of products are the symmetric matrix of exposure and error.
    left = jnp.sum(pairs[:, 3:], axis=0)[np.array([[0, 1], [1, 2]])]
    corner = left * scales[:, None] * scales[None]
    others = local.by_observation * scales
    return GroupTerms(
        local.value,
        jnp.concatenate([local.by_log @ design, others]),
        jnp.block([[both, border], [border.T, corner]]),
    )


def _whittle(
    diffusion: Float[Array, "time track axis"],
    intervals: Float[Array, "time track axis"],
    exposure: Float[Array, ""],
    variance: Float[Array, ""],
) -> list[Float[Array, "time track axis"]]:
    """Information of each interval on log D, exposure and variance: its upper half.

    A loop over frequencies that is compiled as one: no array of all is ever made.
    """
    blur = jnp.minimum(exposure, intervals) / 3
    pairs = [jnp.zeros_like(diffusion)] * 6
    # Midpoints: at zero frequency a localisation error adds nothing.
    for frequency in np.pi * (np.arange(FREQUENCIES) + 0.5) / FREQUENCIES:
        turn = float(1 - np.cos(frequency))
        motion = 2 * diffusion * (intervals - blur * turn)
        fraction = 1 / (motion + 2 * variance * turn)
        slopes = (
            motion * fraction,
            -2 / 3 * turn * diffusion * fraction,
            2 * turn * fraction,
        )
        products = [
            slopes[i] * slopes[j]
            for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
        ]
        pairs = [
            total + 0.5 / FREQUENCIES * product
            for total, product in zip(pairs, products, strict=True)
        ]
    return pairs


def _entries(marks: Any, motion: ThermalMotion, group: int) -> np.ndarray:
    """Where level, weights, log odds and log error stand among all parameters.

    Args:
        marks: leaves that hold one more than their place; None where not learned.
    """
    count = motion.diffusion.weights.shape[1]

    def places(leaf: Array | None, size: int) -> np.ndarray:
        if leaf is None:
            return np.full(size, -1)
        return np.atleast_1d(np.asarray(leaf[group])).astype(int) - 1

    return np.concatenate(
        [
            places(marks.diffusion.levels, 1),
            places(marks.diffusion.weights if count else None, count),
            places(marks.log_odds, 1),
            places(marks.log_errors, 1),
        ]
    )


def _weights(motion: ThermalMotion) -> AbstractWeights:
    """The prior of log D: a process for each group, independent of the others."""
    basis, groups = motion.diffusion.basis, motion.diffusion.groups
    if not len(basis.centers):
        return NoWeights()
    processes: list[AbstractPrior] = [
        StationaryPrior(basis.centers, 1.0, smooth=True) for _ in groups
    ]
    return GaussianWeights(reduce(MixturePrior, processes))


def _priors(
    names: tuple[str, ...], observation: LearnedObservation | None
) -> ConstantPriors:
    """Weak priors of exposure and error, where they are learned."""
    if observation is None:
        return ConstantPriors()
    odds = Normal(0.0, observation.spread)
    errors = Normal(float(np.log(observation.error)), observation.error_spread)
    pairs = [
        (i, odds if name.startswith("log_odds") else errors)
        for i, name in enumerate(names)
        if name.startswith(("log_odds", "log_errors"))
    ]
    return ConstantPriors(tuple(i for i, _ in pairs), tuple(p for _, p in pairs))
