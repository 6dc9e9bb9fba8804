"""`fit_bayes`: a kernel environment from noisy data, with everything it needs.

Lifted Gauss-Newton steps with the starts eliminated; at every step the evidence
chooses shape of the prior, amplitude and noise anew, so that nothing is set by hand.
"""

import enum
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Bool, Float, PyTree

from pinav.dynamics import AbstractDynamics, Swimmer, with_dtype
from pinav.errors import FitError, InputError
from pinav.fitting.descent import (
    AbstractDescent,
    ChordSteps,
    FullStep,
    Local,
    Move,
)
from pinav.fitting.evidence import (
    FlatBlock,
    Hyperparameters,
    Quadratic,
    is_singular,
    joint_posterior,
    without_flat,
)
from pinav.fitting.inference import (
    AbstractWeights,
    GaussianWeights,
    Inference,
    NoWeights,
)
from pinav.fitting.kernels import WeightPrior
from pinav.fitting.lifting import (
    FreeModel,
    Linearisation,
    freed,
    linearise,
)
from pinav.fitting.objectives import Observations
from pinav.fitting.posterior import Posterior
from pinav.fitting.smoother import smoothed_states
from pinav.forces import AbstractForce
from pinav.learned import AbstractLearnedForce, KernelForce, KernelPotential
from pinav.solvers import FixedStep
from pinav.trajectories import Trajectories

EVIDENCE_TOLERANCE, DEFECT_TOLERANCE = 1e-2, 1e-4
"""Converged: change of the log evidence, and defects relative to the states' spread."""

ROUNDING = 1e-9
"""Defects at which another step changes nothing but the last digits of the evidence."""


class BayesOutcome(enum.IntEnum):
    """How a Bayesian fit ended."""

    CONVERGED = 0
    STALLED = 1
    DIVERGED = 2


class Estimate(eqx.Module):
    """A learned constant.

    Attributes:
        value: its best value.
        sd: its standard deviation.
    """

    value: float
    sd: float


class BayesFit(eqx.Module):
    """A fitted kernel environment, and how well it is known.

    Attributes:
        model: the model with its best parameters.
        outcome: stalled when the iterations ran out, diverged when the defects grew
            or became infinite; the rest is then what was reached last.
        iterations: Gauss-Newton steps taken.
        hyperparameters: noise, shape of the prior (`WeightPrior`), amplitude, and the
            log evidence.
        posterior: distribution of all learned parameters.
        constants: learned constants by the path of their leaf, as `drag.damping`.
        states: the smoothed states; they fulfil the dynamics when converged.
    """

    model: Any
    outcome: BayesOutcome = eqx.field(static=True)
    iterations: int = eqx.field(static=True)
    hyperparameters: Hyperparameters
    posterior: Posterior
    constants: dict[str, Estimate]
    states: Float[np.ndarray, "trajectory time state"]


def fit_bayes(
    model: AbstractDynamics,
    trajectories: Trajectories,
    *,
    learn: Callable[[Any], PyTree] = lambda _: (),
    noise: float | None = None,
    solver: FixedStep | None = None,
    max_iterations: int = 20,
    throw: bool = True,
) -> BayesFit:
    r"""Fit the environment of a swimmer, and constants, to noisy trajectories.

    The weights of a kernel environment have a Gaussian-process prior; constants,
    parametric environments and all starts have a flat one. The rollout is a strong
    constraint: no process noise. The result needs neither velocities nor regular
    times. A constant force along the thrust is hard to tell from a wide slope of the
    environment: where the thrust is learned, its standard deviation says so.

    Args:
        model: dynamics with a field `environment`, of second order (`Swimmer`) or,
            where the state is the position, of first. With a `KernelForce` or a
            `KernelPotential`, such as `kernel_environment` makes, its weights are
            learned; with any other force what `learn` picks of it. The fit starts
            from the model's values.
        trajectories: what was observed; any entries may be missing.
        learn: picks a constant to learn too, such as `lambda m: m.drag.damping`, or
            a tuple of them; `lambda m: m.environment` picks all numbers of a
            parametric force.
        noise: standard deviation of the observations; estimated unless given.
        solver: steps between samples; `FixedStep()` unless given.
        max_iterations: after which the fit counts as stalled.
        throw: raise where the fit did not converge.

    Raises:
        InputError: there is nothing to learn, the trajectories are not its own, or are
            too few, or `noise` is not positive.
        FitError: the data do not determine the constants or a start, or the fit did
            not converge and `throw` is true.
    """
    _check(model, noise, max_iterations)
    with jax.enable_x64(new_val=True):
        solver = FixedStep() if solver is None else solver
        problem = _Problem.of(model, trajectories, learn, noise, solver)
        result = problem.result(*_iterate(problem, max_iterations))
    if throw and result.outcome is not BayesOutcome.CONVERGED:
        raise FitError(_MESSAGES[result.outcome])
    return result


_MESSAGES = {
    BayesOutcome.STALLED: (
        "the fit stalled: its iterations ran out before the states fulfilled the "
        "dynamics; raise max_iterations, or pass throw=False to get what was reached"
    ),
    BayesOutcome.DIVERGED: (
        "the fit diverged: the states depart from the dynamics; check the known "
        "forces, add substeps, or pass throw=False to get what was reached"
    ),
}


class _Step(eqx.Module):
    """One step: what the data said before it, and where it led."""

    defect: float
    inference: Inference
    quadratic: Quadratic
    block: FlatBlock
    covariance: Float[np.ndarray, "parameter parameter"]
    move: Move


def _iterate(
    problem: "_Problem", max_iterations: int
) -> tuple[BayesOutcome, list[_Step]]:
    """Steps until they converge, diverge or run out."""
    move = Move(problem.theta, problem.states, problem.descent)
    shape = problem.weights.start
    steps: list[_Step] = []
    while len(steps) < max_iterations:
        step = problem.step(move, shape)
        if step is None:
            return BayesOutcome.DIVERGED, steps
        move, shape = step.move, step.inference.hyperparameters.shape
        steps.append(step)
        outcome = _outcome(steps)
        if outcome is not BayesOutcome.STALLED:
            return outcome, steps
    return BayesOutcome.STALLED, steps


def _outcome(steps: list[_Step]) -> BayesOutcome:
    """Converged, or not yet; defects that grow without bound count as diverged."""
    last = steps[-1]
    if len(steps) > 1:
        before = steps[-2].inference.hyperparameters.log_evidence
        change = abs(last.inference.hyperparameters.log_evidence - before)
        if change < EVIDENCE_TOLERANCE and last.defect < DEFECT_TOLERANCE:
            return BayesOutcome.CONVERGED
    if last.defect < ROUNDING:
        return BayesOutcome.CONVERGED
    if last.defect > 100 * max(steps[0].defect, 1.0):
        return BayesOutcome.DIVERGED
    return BayesOutcome.STALLED


class _Problem(eqx.Module):
    """The start of a fit, and its parts that do not change while it runs."""

    free: FreeModel
    theta: Float[np.ndarray, " parameter"]
    states: Float[jax.Array, "trajectory time state"]
    num_free: int
    weights: AbstractWeights
    descent: AbstractDescent
    names: tuple[str, ...]
    flat: Bool[np.ndarray, " parameter"]
    observations: Observations
    scale: Float[np.ndarray, " state"]
    noise: float | None
    solver: FixedStep

    @classmethod
    def of(cls, model, trajectories, learn, noise, solver):
        _check_selection(model, learn)
        free, theta = freed(with_dtype(model, jnp.float64), _trainable(learn))
        names, flat = _names(free, theta), ~_is_weight(free, theta)
        _check_learned(model, names, flat)
        states = smoothed_states(trajectories, _num_positions(model, trajectories))
        num_free = trajectories.num_observed - states[:, 0].size
        if num_free <= flat.sum():
            raise InputError(
                f"fit_bayes trajectories: {trajectories.num_observed} observations "
                "are no more than the starts and constants to be found; add samples"
            )
        weights, descent = _weights_and_descent(model)
        return cls(
            free=free,
            theta=np.asarray(theta),
            states=jnp.asarray(states),
            num_free=num_free,
            weights=weights,
            descent=descent,
            names=names,
            flat=flat,
            observations=Observations.of(trajectories, jnp.float64),
            scale=_spread(states, trajectories.lengths),
            noise=noise,
            solver=solver,
        )

    def step(self, move: Move, shape) -> _Step | None:
        """One step, or None where the linearisation is not finite."""
        theta, states = move.theta, move.states
        linear = linearise(
            self.free, jnp.asarray(theta), states, self.observations, self.solver
        )
        if not np.all(np.isfinite(linear.start_information)):
            return None
        _check_starts(linear)
        if not np.all(np.isfinite(linear.hessian)):
            return None
        quadratic, block = without_flat(self.quadratic(theta, linear), self.flat)
        found = self.weights.infer(quadratic, shape, self.noise)
        chosen = found.hyperparameters
        mean, covariance = joint_posterior(
            block, found.mean, found.covariance, chosen.noise
        )
        local = Local(
            free=self.free,
            observations=self.observations,
            solver=self.solver,
            theta=theta,
            states=states,
            linear=linear,
            precision=self.precision(chosen),
            noise=chosen.noise,
        )
        return _Step(
            defect=float(np.max(np.asarray(linear.defects) / self.scale)),
            inference=found,
            quadratic=quadratic,
            block=block,
            covariance=covariance,
            move=move.descent(local, mean),
        )

    def precision(self, chosen: Hyperparameters):
        """Prior precision of each parameter on its own; zero where it is flat."""
        precision = np.zeros(len(self.flat))
        precision[~self.flat] = chosen.amplitude**-2 if chosen.amplitude else 0.0
        return precision

    def quadratic(self, theta, linear: Linearisation) -> Quadratic:
        starts = np.asarray(linear.start_information)
        return Quadratic(
            theta,
            np.asarray(linear.hessian),
            np.asarray(linear.gradient),
            float(linear.squares),
            num_free=self.num_free,
            log_determinant=float(np.linalg.slogdet(starts).logabsdet.sum()),
        )

    def with_shape_uncertainty(self, step: _Step) -> Posterior:
        """The posterior after a step, that of the prior's shape included."""
        extra = self.weights.shape_covariance(
            step.quadratic, step.inference.hyperparameters, self.noise
        )
        covariance = step.covariance + step.block.lift(extra)
        return Posterior(self.free, step.move.theta, covariance)

    def result(self, outcome: BayesOutcome, steps: list[_Step]) -> BayesFit:
        if not steps:
            raise FitError(
                "the fit diverged at once: the model's rates of change are not finite "
                "at the observed states; check its constants"
            )
        last = steps[-1]
        posterior = self.with_shape_uncertainty(last)
        sd = np.sqrt(np.diag(posterior.covariance))
        constants = {
            self.names[i]: Estimate(float(posterior.mean[i]), float(sd[i]))
            for i in np.flatnonzero(self.flat)
        }
        return BayesFit(
            model=posterior.model,
            outcome=outcome,
            iterations=len(steps),
            hyperparameters=last.inference.hyperparameters,
            posterior=posterior,
            constants=constants,
            states=np.asarray(last.move.states),
        )


def _weights(model) -> tuple:
    """The leaves that have a Gaussian prior; none in a parametric environment."""
    environment = model.environment
    if isinstance(environment, AbstractLearnedForce):
        return (environment.parameters,)
    return ()


def _weights_and_descent(model) -> tuple[AbstractWeights, AbstractDescent]:
    """The prior of the environment's weights, and steps as curved as they are."""
    environment = model.environment
    if isinstance(environment, KernelForce | KernelPotential):
        return GaussianWeights(WeightPrior(environment)), FullStep()
    return NoWeights(), ChordSteps(damping=1e-2)


def _trainable(learn):
    def select(model):
        constants = learn(model)
        several = constants if isinstance(constants, tuple | list) else (constants,)
        return *_weights(model), *several

    return select


def _is_weight(free: FreeModel, theta) -> Bool[np.ndarray, " parameter"]:
    """Which entries of the parameter vector are weights of the environment."""
    marks = free.unravel(jnp.zeros_like(theta))
    if jax.tree.leaves(_weights(marks)):
        marks = eqx.tree_at(
            _weights, marks, jax.tree.map(jnp.ones_like, _weights(marks))
        )
    return np.asarray(ravel_pytree(marks)[0]) > 0


def _num_positions(model, trajectories: Trajectories) -> int:
    """How many channels are positions; what follows them are velocities.

    Raises:
        InputError: the trajectories have other channels than the model has states.
    """
    count = len(trajectories.channels)
    dim = _dimension(model.environment)
    if isinstance(model, Swimmer):
        dim = count // 2 if dim is None else dim
        fits, expected = count == 2 * dim, f"{2 * dim} channels, positions and"
        expected += " velocities"
    else:
        dim = count if dim is None else dim
        fits, expected = count in (dim, 2 * dim), f"{dim} or {2 * dim} channels"
    if not fits:
        raise InputError(
            f"fit_bayes trajectories: expected {expected}, got "
            f"{', '.join(trajectories.channels)}"
        )
    return dim


def _dimension(environment) -> int | None:
    """Dimension of the space in which a learned environment acts."""
    if isinstance(environment, KernelForce | KernelPotential):
        return environment.centers.shape[1]
    return None


def _names(free: FreeModel, theta) -> tuple[str, ...]:
    """A name for every entry of the parameter vector: the path of its leaf."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(free.unravel(theta))
    names = []
    for path, leaf in leaves:
        name = jax.tree_util.keystr(path).lstrip(".")
        indices = np.ndindex(*leaf.shape) if leaf.ndim else [None]
        names += [name if i is None else f"{name}{list(i)}" for i in indices]
    return tuple(names)


def _spread(states, lengths):
    """Standard deviation of each channel over all samples; 1 where it is constant."""
    samples = np.concatenate(
        [own[:length] for own, length in zip(states, lengths, strict=True)]
    )
    spread = samples.std(axis=0)
    return np.where(spread > 0, spread, 1.0)


def _check_starts(linear: Linearisation) -> None:
    for index, matrix in enumerate(np.asarray(linear.start_information)):
        if is_singular(matrix):
            raise FitError(
                f"the fit is singular: the observations of trajectory {index} do not "
                "determine its start; drop the trajectory"
            )


def _check(model, noise, max_iterations):
    if not isinstance(getattr(model, "environment", None), AbstractForce):
        raise InputError(
            "fit_bayes model: expected dynamics with a force called environment, got "
            f"{type(model).__name__}"
        )
    if noise is not None and not 0 < noise < np.inf:
        raise InputError(
            f"fit_bayes noise: expected a finite number > 0, got {noise}; leave it "
            "out to estimate it"
        )
    if max_iterations < 1:
        raise InputError(
            f"fit_bayes max_iterations: expected >= 1, got {max_iterations}"
        )


def _check_learned(model, names, flat):
    """Of an environment with weights these alone are learned."""
    if not isinstance(model.environment, AbstractLearnedForce):
        return
    for name in np.array(names)[flat]:
        if name.startswith("environment."):
            raise InputError(
                f"fit_bayes learn: {name} belongs to the environment, whose "
                "weights alone are learned; pick constants of other forces"
            )


def _check_selection(model, learn):
    leaves = jax.tree.leaves(_trainable(learn)(model))
    if not any(isinstance(x, float) or eqx.is_inexact_array(x) for x in leaves):
        raise InputError(
            f"fit_bayes learn: {type(model.environment).__name__} has no weights; "
            "make an environment by kernel_environment, or pick numbers to learn, "
            "such as learn=lambda m: m.environment"
        )
