"""Diffusion, drift and reference in turns, each by its likelihood given the others."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.dynamics import OverdampedSwimmer
from pinav.errors import FitError
from pinav.fitting.engine.evidence_fit import EvidenceFit, iterate
from pinav.fitting.engine.problem import Step
from pinav.fitting.environments.refinement import Refinement
from pinav.fitting.langevin.checks import (
    LangevinChecks,
    innovation_correlations,
    thinned_diffusion,
)
from pinav.fitting.langevin.covariance import cut, factorise, increment_bands
from pinav.fitting.langevin.diffusion import DiffusionField, ThermalMotion
from pinav.fitting.langevin.drift import (
    Transition,
    WhitenedIncrements,
    at_each,
    fit_force,
    force_problem,
    transitions,
    without_level,
)
from pinav.fitting.langevin.increments import (
    Increments,
    ObservedAxes,
    Padding,
    Relation,
)
from pinav.fitting.langevin.likelihood import DiffusionProblem, Fluctuations
from pinav.trajectories import Trajectories

SCORING_STEPS, LATER_STEPS = 10, 3
"""Steps of Fisher's scoring at most, from moments and from the round before."""


class RoundResult(eqx.Module):
    """What is known after a round.

    Attributes:
        means: of the increments [L].
        increments: with positions from the reference.
        relation: what is learned, and how drift and diffusion hang together.
        determined: numbers of the drift that the increments determine.
    """

    swimmer: OverdampedSwimmer
    motion: ThermalMotion
    transition: Transition
    means: Float[Array, "increment dim"]
    increments: Increments
    relation: Relation
    padding: Padding
    determined: float = 0.0

    @classmethod
    def first(
        cls,
        swimmer: OverdampedSwimmer,
        motion: ThermalMotion,
        increments: Increments,
        relation: Relation,
    ) -> "RoundResult":
        """Constant diffusion and no drift."""
        short = Transition.of_short_steps(increments, motion.diffusion)
        padding = Padding.of(increments.counts)
        return cls(swimmer, motion, short, short.means, increments, relation, padding)

    def follow(self, swimmer: Any, determined: float) -> "RoundResult":
        """With another force, and the transitions that follow from it.

        Args:
            determined: numbers of it that the increments determine.
        """
        increments, diffusion = self.increments, self.motion.diffusion
        step = transitions(swimmer, diffusion, increments, self.relation)
        return dataclasses.replace(
            self,
            swimmer=swimmer,
            transition=step,
            means=step.means,
            determined=determined,
        )

    def moved_from(self, before: "RoundResult") -> float:
        """Squared change of all means, in variances of the increments."""
        change = np.asarray(self.means - before.means)
        spread = 2 * self.local_diffusion * self.increments.intervals[:, None]
        return float((change**2 / spread).sum())

    @property
    def local_diffusion(self) -> Float[np.ndarray, "increment dim"]:
        """Diffusion at the start of each increment [L² T⁻¹]."""
        positions = jnp.asarray(self.increments.positions)
        return np.asarray(at_each(self.motion.diffusion.diagonal, positions))


def fluctuations(belief: RoundResult) -> Fluctuations:
    """Increments about the means of a belief."""
    increments, step, padding = belief.increments, belief.transition, belief.padding
    tensor = belief.motion.diffusion
    residuals = padding.pad(jnp.asarray(increments.steps) - belief.means)
    # What the drift follows of the noise is missing from its residuals.
    left = max(1.0 - belief.determined / increments.steps.size, LEAST_LEFT)
    residuals = residuals / np.sqrt(left)
    kernels = at_each(tensor.basis, jnp.asarray(increments.positions))
    ones = jnp.ones((len(kernels), 1))
    design = jnp.concatenate([ones, kernels], axis=1)[:, None] + step.slopes
    start = jnp.concatenate([tensor.levels[:, None], tensor.weights], axis=1)
    # The factors are linear in level and weights about the belief: without their
    # slopes, an error of the curvature of log D would feed itself from turn to turn.
    shifts = jnp.einsum("ngp,gp->ng", step.slopes, start)[:, tensor.group_of_axis]
    return Fluctuations(
        residuals=residuals * padding.mask[..., None],
        offsets=padding.pad(jnp.log(step.factors) - shifts),
        kept=padding.pad(step.kept),
        intervals=padding.pad(jnp.asarray(increments.intervals)),
        design=design,
        padding=padding,
    )


def fit_motion(
    belief: RoundResult, max_steps: int
) -> tuple[RoundResult, DiffusionProblem | None, Step | None]:
    """Diffusion and observation given the drift; unchanged where both are known.

    Args:
        max_steps: of Fisher's scoring at most.
    """
    relation = belief.relation
    if not relation.learn_diffusion and relation.observation is None:
        return belief, None, None
    problem = DiffusionProblem.of(belief.motion, fluctuations(belief), relation)
    _, steps = iterate(problem, max_steps)
    if not steps:
        raise FitError("the fit diverged at once: no likelihood of the diffusion")
    motion: Any = problem.parametric(jnp.asarray(steps[-1].move.theta))
    return eqx.tree_at(lambda b: b.motion, belief, motion), problem, steps[-1]


def whiten_increments(belief: RoundResult) -> WhitenedIncrements:
    """The increments as innovations of the belief's thermal motion."""
    increments, motion = belief.increments, belief.motion
    positions = jnp.asarray(increments.positions)
    intervals = jnp.asarray(increments.intervals)
    step, padding = belief.transition, belief.padding
    targets = jnp.asarray(increments.steps) - step.offsets
    factor = _factor(motion, positions, intervals, step, padding)
    diffusion = at_each(motion.diffusion.diagonal, positions)
    # Where a camera errs, a part of the variance is that of the step.
    steps = 2 * diffusion * step.factors * intervals[:, None]
    bands = padding.flatten(factor.diagonal**2)
    by_steps = jnp.minimum(steps / bands, 1.0)
    excess = (jnp.asarray(increments.steps) - step.means) ** 2 / bands - 1.0
    # The first round knows no slope.
    excess = jnp.where(jnp.any(step.widening), excess, 0.0)
    groups = _groups(motion) if belief.relation.learn_diffusion else None
    return WhitenedIncrements(
        increments=increments,
        targets=targets,
        gains=step.gains,
        widening=by_steps[..., None] * step.widening,
        excess=excess + by_steps * step.widths,
        diffusion=diffusion,
        factor=factor,
        padding=padding,
        surplus=0.5 * jnp.sum(without_level(excess, groups) ** 2),
        groups=groups,
    )


def _groups(motion: ThermalMotion) -> Float[np.ndarray, "axis group"]:
    """One where an axis belongs to a group, else zero."""
    return np.eye(len(motion.diffusion.groups))[motion.diffusion.group_of_axis]


def levels_share(
    belief: RoundResult, fit: EvidenceFit
) -> Float[np.ndarray, "group group"]:
    """Covariance of the levels of log D that follows from that of the drift.

    Where steps are not short a steeper drift narrows them, and more diffusion widens
    them.
    """
    posterior, groups = fit.posterior, _groups(belief.motion)
    white = dataclasses.replace(whiten_increments(belief), groups=None)
    _, slopes = white.linearise(posterior.free, np.asarray(posterior.mean))
    widths = np.sqrt(2.0) * slopes[belief.increments.steps.size :]
    mean = widths.reshape(len(belief.increments.steps), len(groups), -1).mean(axis=0)
    by_level = (groups / groups.sum(axis=0)).T @ mean
    return by_level @ posterior.covariance @ by_level.T


LEAST_LEFT = 0.1
"""Share of the increments that the drift leaves to the diffusion, at least."""


@eqx.filter_jit
def _factor(
    motion: ThermalMotion,
    positions: Float[Array, "increment dim"],
    intervals: Float[Array, " increment"],
    step: Transition,
    padding: Padding,
) -> Any:
    groups = motion.diffusion.group_of_axis
    local = padding.pad(jax.vmap(motion.diffusion.diagonal)(positions) * step.factors)
    shape = local.shape
    mask = jnp.broadcast_to(padding.mask[..., None], shape)
    durations = jnp.broadcast_to(padding.pad(intervals)[..., None], shape)
    exposures = jnp.broadcast_to(motion.exposures[groups][None, None], shape)
    variances = jnp.broadcast_to(motion.variances[groups][None, None], shape)
    kept = padding.pad(step.kept)
    bands = increment_bands(local, durations, exposures, variances, kept)
    return factorise(cut(bands, mask))


def fit_drift(
    belief: RoundResult, refine: Refinement | None, trajectories: Trajectories
) -> tuple[RoundResult, EvidenceFit]:
    """The force given diffusion and observation, and what follows from it."""
    swimmer = belief.relation.swimmer_in(belief.swimmer, belief.motion.diffusion)
    innovations = whiten_increments(belief)
    fit, step = fit_force(swimmer, innovations, 1.0, refine, trajectories)
    return belief.follow(fit.model, step.num_determined), fit


def diffusion_share(
    belief: RoundResult, fit: EvidenceFit, field: DiffusionField
) -> EvidenceFit:
    """The fit whose posterior counts the uncertainty of D, by refits of draws."""
    relation = belief.relation
    if not (relation.einstein and relation.learn_diffusion):
        return fit
    weights, chosen = fit.linear.weights, fit.hyperparameters
    means = []
    for tensor in field.samples(DRAWS):
        there = eqx.tree_at(lambda b: b.motion.diffusion, belief, tensor)
        there = there.follow(fit.model, belief.determined)
        swimmer = relation.swimmer_in(fit.model, tensor)
        problem = force_problem(swimmer, whiten_increments(there), 1.0)
        local = problem.linearise(problem.theta, None)
        if local is not None:
            means.append(weights.posterior(local.quadratic, chosen)[0])
    # The law of total variance: what the drift shifts with the diffusion adds to the
    # spread at a given diffusion.
    spread = np.cov(np.array(means), rowvar=False) if len(means) > 1 else 0.0
    covariance = fit.posterior.covariance + spread
    return eqx.tree_at(lambda f: f.posterior.covariance, fit, covariance)


DRAWS = 6
"""Diffusions drawn for their share in the uncertainty of the force: that share is then
known to a third, and it is the smaller part."""


def langevin_checks(
    belief: RoundResult, observation: tuple[ObservedAxes, ...]
) -> LangevinChecks:
    """What the innovations say of a belief."""
    increments = belief.increments
    white = whiten_increments(belief)
    innovations = white.in_time(np.asarray(eqx.filter_jit(white)(belief.swimmer)))
    residuals = increments.in_time(np.asarray(increments.steps - belief.means).ravel())
    expected = belief.local_diffusion * increments.intervals[:, None]
    expected = expected * np.asarray(belief.transition.factors)
    motions = increments.in_time(expected.ravel())
    groups = belief.motion.diffusion.groups
    return LangevinChecks(
        correlations=innovation_correlations(innovations),
        counts=len(increments.steps),
        thinned=tuple(
            ratio
            for every in (2, 3)
            for ratio in thinned_diffusion(residuals, motions, groups, every)
        ),
        observation=observation,
    )


def motion_covariance(
    problem: DiffusionProblem | None, step: Step | None, motion: ThermalMotion
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Covariance of levels and weights of log D, and deviations of the observation.

    Returns:
        Zeros for what is known; deviations of log odds and of log errors of each group.
    """
    groups, kernels = motion.diffusion.weights.shape
    count = groups * (1 + kernels)
    whole = np.zeros((count + 2 * groups,) * 2)
    if problem is not None and step is not None:
        names = ["diffusion.levels"] * groups
        names += ["diffusion.weights"] * (groups * kernels)
        names += ["log_odds"] * groups + ["log_errors"] * groups
        learned = {name.partition("[")[0] for name in problem.names}
        kept = np.array([name in learned for name in names])
        whole[np.ix_(kept, kept)] = problem.posterior(step).covariance
    sds = np.sqrt(np.maximum(np.diag(whole)[count:], 0.0))
    return whole[:count, :count], sds[:groups], sds[groups:]
