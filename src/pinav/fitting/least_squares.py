r"""Nonlinear least squares with priors and evidence, for any vector of residuals.

What `fit_bayes` does for trajectories, without states: residuals
$r(\theta) \sim N(0, \sigma^2)$, Gaussian priors of some parameters whose
hyperparameters the evidence chooses, flat ones of the others; the same steps, the same
Laplace posterior.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, PyTree

from pinav.errors import FitError, InputError
from pinav.fitting.bayes.iterate import (
    DEFECT_TOLERANCE,
    EvidenceProgress,
    iterate,
)
from pinav.fitting.bayes.parameters import parameter_names
from pinav.fitting.bayes.problem import Step
from pinav.fitting.bayes.steps import AbstractLocalModel, ChordSteps, Move
from pinav.fitting.engine.evidence_fit import EvidenceFit
from pinav.fitting.engine.multiple_shooting import (
    ParametricModel,
    Prediction,
    ravel_model,
)
from pinav.fitting.engine.posterior import Estimate, Posterior
from pinav.fitting.evidence.evidence import Hyperparameters
from pinav.fitting.evidence.model_evidence import LinearFit
from pinav.fitting.evidence.quadratic import Quadratic, eliminate_flat, joint_posterior
from pinav.fitting.evidence.weights import AbstractWeights, GaussianWeights, NoWeights
from pinav.fitting.outcome import Outcome
from pinav.forces.priors import AbstractPrior

SMALL_CHANGE, SMALLEST = 0.02, 1e-9
"""Change of a prediction that ends a fit: in standard deviations of the noise, or as a
share of what is observed where there is none. That change is one that the linear model
still asks for, so that a step that finds nothing better is no end."""

TANGENTS = 16
"""Columns of the Jacobian that are computed at once."""

Residuals = Callable[[Any], Float[Array, " residual"]]
"""From a model to predicted less observed values."""


def fit_regression(
    model: Any,
    residuals: Residuals,
    *,
    weights: Callable[[Any], PyTree] = lambda _: (),
    prior: AbstractPrior | None = None,
    constants: Callable[[Any], PyTree] = lambda _: (),
    scale: float = 1.0,
    noise: float | None = None,
    tolerance: float = 1e-2,
    max_iterations: int = 30,
    on_step: Callable[[EvidenceProgress], None] | None = None,
    throw: bool = True,
) -> EvidenceFit:
    """Fit parameters of a model to data by what it predicts of them.

    Args:
        model: where the fit starts.
        residuals: predicted less observed values of a model; a pytree, so that what it
            holds is not compiled in.
        weights: picks the leaves with a Gaussian prior.
        prior: of those, flattened as they are; needed where there are any.
        constants: picks the leaves with a flat prior.
        scale: size of what is observed, for data without noise.
        noise: standard deviation of the residuals; estimated unless given.
        tolerance: change of the log evidence at which the fit ends.
        max_iterations: after which the fit counts as stalled.
        on_step: called after each step.
        throw: raise where the fit did not converge.

    Raises:
        InputError: there is nothing to learn, or fewer residuals than constants.
        FitError: the data do not determine the constants, or the fit did not converge
            and `throw` is true.
    """
    with jax.enable_x64(new_val=True):
        problem = Regression.of(
            model,
            residuals,
            weights,
            prior,
            constants,
            noise=noise,
            scale=scale,
            tolerance=tolerance,
        )
        outcome, steps = iterate(problem, max_iterations, on_step)
    if throw and outcome is not Outcome.CONVERGED:
        raise FitError(
            f"the fit {outcome.name.lower()} after {len(steps)} steps; change where it "
            "starts, raise max_iterations, or pass throw=False"
        )
    if not steps:
        raise FitError(
            "the fit diverged at once: its residuals are not finite where it starts"
        )
    return problem.result(outcome, steps)


class Regression(eqx.Module):
    """A regression as a problem: its unknowns, its start and its steps.

    Attributes:
        free: the model as a function of its parameters.
        residuals: of a model.
        theta: the parameters at the start.
        weights: what is known of the weights before the data.
        names: of all parameters.
        flat: which of them have a flat prior.
        noise: standard deviation of the residuals, where it is known.
        scale: size of what is observed.
        tolerance: change of the log evidence at which the fit ends.
    """

    free: ParametricModel
    residuals: Residuals
    theta: Float[np.ndarray, " parameter"]
    weights: AbstractWeights
    names: tuple[str, ...]
    flat: Bool[np.ndarray, " parameter"]
    noise: float | None
    scale: float
    tolerance: float

    @classmethod
    def of(
        cls, model, residuals, weights, prior, constants, *, noise, scale, tolerance
    ):
        def chosen(m):
            return weights(m), constants(m)

        picked = jax.tree.leaves(chosen(model))
        if not any(isinstance(x, float) or eqx.is_inexact_array(x) for x in picked):
            raise InputError(
                "fit_regression: nothing to learn; pick weights or constants"
            )
        free, theta = ravel_model(model, chosen)
        marks = free.unravel(jnp.zeros_like(theta))
        if own := jax.tree.leaves(constants(marks)):
            ones = [jnp.ones_like(leaf) for leaf in own]
            marks = eqx.tree_at(lambda m: jax.tree.leaves(constants(m)), marks, ones)
        flat = np.asarray(ravel_pytree(marks)[0]) > 0
        count = eqx.filter_eval_shape(residuals, model).shape[0]
        if count <= flat.sum():
            raise InputError(
                f"fit_regression: expected more than {flat.sum()} residuals, one for "
                f"each constant, got {count}"
            )
        known = NoWeights() if prior is None else GaussianWeights(prior)
        return cls(
            free=free,
            residuals=residuals,
            theta=np.asarray(theta),
            weights=known,
            names=parameter_names(free, theta),
            flat=flat,
            noise=noise,
            scale=scale,
            tolerance=tolerance,
        )

    @property
    def states(self):
        """The residuals stand where a lifted fit has its states; none as yet."""
        return jnp.zeros((1, 1, 0))

    @property
    def descent(self):
        """Damped steps: the model need not be linear in its parameters."""
        return ChordSteps(damping=1e-2 if self.flat.all() else 1.0)

    def step(self, move: Move, shape) -> Step | None:
        """One step, or None where the linearisation is not finite."""
        residuals, jacobian = _linearised(
            self.free, self.residuals, jnp.asarray(move.theta)
        )
        rows, right = np.asarray(jacobian), np.asarray(residuals)
        if not (np.all(np.isfinite(rows)) and np.all(np.isfinite(right))):
            return None
        whole = Quadratic(
            point=move.theta,
            hessian=rows.T @ rows,
            gradient=rows.T @ right,
            squares=float(right @ right),
            num_free=len(right),
            log_determinant=0.0,
        )
        quadratic, block = eliminate_flat(whole, self.flat)
        weights = self.weights.about(move.theta[~self.flat])
        found = weights.infer(quadratic, shape, self.noise)
        chosen = found.hyperparameters
        mean, covariance = joint_posterior(
            block, found.mean, found.covariance, chosen.noise
        )
        local = LocalRegression(
            free=self.free,
            residuals=self.residuals,
            theta=move.theta,
            jacobian=rows,
            precision=self.precision(chosen),
            noise=max(chosen.noise, np.finfo(float).eps * self.scale),
            energy=lambda theta: weights.energy(theta[~self.flat]),
        )
        wanted = np.abs(rows @ (mean - move.theta)).max()
        allowed = max(SMALL_CHANGE * chosen.noise, SMALLEST * self.scale)
        return Step(
            defect=float(DEFECT_TOLERANCE * wanted / allowed),
            inference=found,
            quadratic=quadratic,
            block=block,
            covariance=covariance,
            move=move.descent(local, mean),
            weights=weights,
        )

    def precision(self, chosen: Hyperparameters) -> Float[np.ndarray, " parameter"]:
        """Prior precision of each parameter on its own; zero where it is flat."""
        precision = np.zeros(len(self.flat))
        precision[~self.flat] = self.weights.ridge(chosen)
        return precision

    def linear_fit(self, step: Step) -> LinearFit:
        """The linear problem of a step, for the evidence of the model."""
        flat = int(self.flat.sum())
        total = step.quadratic.num_free + flat
        return LinearFit(
            quadratic=step.quadratic,
            weights=step.weights,
            noise=self.noise,
            num_observed=total,
            flat_information=flat * float(np.log(total)),
        )

    def result(self, outcome: Outcome, steps: list[Step]) -> EvidenceFit:
        """The fit after its steps, the uncertainty of the prior's shape included."""
        last = steps[-1]
        extra = last.weights.shape_covariance(
            last.quadratic, last.inference.hyperparameters, self.noise
        )
        covariance = last.covariance + last.block.lift(extra)
        posterior = Posterior(self.free, last.move.theta, covariance)
        sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        return EvidenceFit(
            model=posterior.model,
            outcome=outcome,
            iterations=len(steps),
            hyperparameters=last.inference.hyperparameters,
            posterior=posterior,
            constants={
                self.names[i]: Estimate(float(posterior.mean[i]), float(sd[i]))
                for i in np.flatnonzero(self.flat)
            },
            states=None,
            linear=self.linear_fit(last),
        )


class LocalRegression(AbstractLocalModel):
    """A regression near one point.

    Attributes:
        free: the model as a function of its parameters.
        residuals: of a model.
        theta: the parameters.
        jacobian: of the residuals there.
        precision: of the prior.
        noise: standard deviation of the residuals.
        energy: what the prior says beyond the precision.
    """

    free: ParametricModel
    residuals: Residuals
    theta: Float[np.ndarray, " parameter"]
    jacobian: Float[np.ndarray, "residual parameter"]
    precision: Float[np.ndarray, " parameter"]
    noise: float
    energy: Callable[[Float[np.ndarray, " parameter"]], float]

    @property
    def hessian(self):
        return self.jacobian.T @ self.jacobian

    def predict(self, theta):
        found = _residuals(self.free, self.residuals, jnp.asarray(theta))[None, None]
        return Prediction(found, found)

    def pull_back(self, residuals):
        return self.jacobian.T @ np.asarray(residuals).reshape(-1)

    def damping_scale(self, hessian):
        return np.diag(hessian)

    def advanced(self, mean):
        return self.predict(mean).states


@eqx.filter_jit
def _residuals(free, residuals, theta):
    return residuals(free(theta))


@eqx.filter_jit
def _linearised(free, residuals, theta):
    """Residuals and their Jacobian, some columns at a time."""
    value, push = jax.linearize(lambda own: residuals(free(own)), theta)
    columns = jax.lax.map(push, jnp.eye(theta.shape[0]), batch_size=TANGENTS)
    return value, columns.T
