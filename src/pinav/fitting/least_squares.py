r"""Nonlinear least squares with priors and evidence, for any vector of residuals.

What `fit_bayes` does for trajectories, without dynamics: residuals
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
from jaxtyping import Array, Bool, Float, PyTree

from pinav.arguments import on_device
from pinav.errors import InputError
from pinav.fitting.engine.evidence_fit import (
    DEFECT_TOLERANCE,
    EvidenceFit,
    EvidenceProgress,
    evidence_fit,
    iterate,
)
from pinav.fitting.engine.local_model import (
    AbstractLocalModel,
    ConstantPriors,
    ParametricModel,
    Prediction,
    States,
    parameter_names,
    ravel_model,
    selected_entries,
)
from pinav.fitting.engine.problem import (
    AbstractProblem,
    AbstractStepRule,
    ChordSteps,
    Step,
)
from pinav.fitting.evidence.model_evidence import LinearFit
from pinav.fitting.evidence.quadratic import Parameters, Quadratic
from pinav.fitting.evidence.weights import AbstractWeights, GaussianWeights, NoWeights
from pinav.fitting.outcome import Outcome
from pinav.forces import AbstractPrior

SMALL_CHANGE, SMALLEST = 0.02, 1e-9
"""Change of a prediction that ends a fit: in standard deviations of the noise, or as a
share of what is observed where there is none. That change is one that the linear model
still asks for, so that a step that finds nothing better is no end."""

TANGENTS = 16
"""Columns of the Jacobian that are computed at once."""

Residuals = Callable[[Any], Float[Array, " residual"]]
"""From a model to predicted less observed values."""

Slopes = tuple[Float[np.ndarray, " residual"], Float[np.ndarray, "residual parameter"]]
"""Residuals, and their slopes by the parameters."""

Linearisation = Callable[[ParametricModel, Parameters], Slopes]
"""From the parameters of a model to residuals and their slopes."""


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
    num_projected: int = 0,
    step_rule: AbstractStepRule | None = None,
    on_step: Callable[[EvidenceProgress], None] | None = None,
    throw: bool = True,
) -> EvidenceFit:
    """Fit parameters of a model to data by what it predicts of them.

    Args:
        residuals: predicted less observed values of a model; a pytree, so that what it
            holds is not compiled in.
        weights: picks the leaves with a Gaussian prior.
        prior: of those, flattened as they are; needed where there are any.
        constants: picks the leaves with a flat prior.
        scale: size of what is observed, for data without noise.
        noise: standard deviation of the residuals; estimated unless given.
        tolerance: change of the log evidence at which the fit ends.
        max_iterations: after which the fit counts as stalled.
        num_projected: residuals that were projected out before.
        step_rule: how to step; damped steps unless given.
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
            weights=weights,
            weights_prior=NoWeights() if prior is None else GaussianWeights(prior),
            constants=constants,
            noise=noise,
            scale=scale,
            tolerance=tolerance,
            num_projected=num_projected,
            step_rule=step_rule,
        )
        outcome, steps = iterate(problem, max_iterations, on_step)
        return evidence_fit(
            problem,
            outcome,
            steps,
            not_finite="its residuals are not finite where it starts",
            advice=dict.fromkeys(
                (Outcome.STALLED, Outcome.DIVERGED) if throw else (),
                f"the fit {outcome} after {len(steps)} steps; change where it starts, "
                "raise max_iterations, or pass throw=False",
            ),
        )


class Regression(AbstractProblem):
    """A regression as a problem: its parameters, its start and its residuals.

    Attributes:
        scale: size of what is observed.
        first_noise: the scale, for all that is observed may be noise.
        least_noise: rounding of what is observed.
        is_linear: whether one step is all there is to do.
        num_projected: residuals that were projected out before.
        log_determinant: of what was integrated out before.
        linearisation: of the residuals, where they have one of their own.
    """

    parametric: ParametricModel
    residuals: Residuals
    theta: Parameters
    weights: AbstractWeights
    names: tuple[str, ...]
    flat: Bool[np.ndarray, " parameter"]
    noise: float | None
    scale: float
    first_noise: float
    least_noise: float
    tolerance: float
    step_rule: AbstractStepRule
    is_linear: bool = False
    num_projected: int = 0
    log_determinant: float = 0.0
    priors: ConstantPriors = ConstantPriors()
    linearisation: Linearisation | None = None
    states: Float[Array, "trajectory time state"] | None = None
    teacher: LinearFit | None = None
    visited: Float[np.ndarray, "place dim"] | None = None

    @classmethod
    def of(
        cls,
        model: Any,
        residuals: Residuals,
        *,
        weights: Callable[[Any], PyTree],
        weights_prior: AbstractWeights,
        constants: Callable[[Any], PyTree] = lambda _: (),
        noise: float | None = None,
        scale: float = 1.0,
        tolerance: float = 1e-2,
        step_rule: AbstractStepRule | None = None,
        **options: Any,
    ) -> "Regression":
        """The problem of a model and residuals; see `fit_regression`.

        Args:
            step_rule: how to step; damped steps unless given, for the model need not
                be linear in its parameters.
            options: further attributes.
        """

        def select(model: Any) -> tuple:
            return weights(model), constants(model)

        picked = jax.tree.leaves(select(model))
        if not any(isinstance(x, float) or eqx.is_inexact_array(x) for x in picked):
            raise InputError(
                "fit_regression: nothing to learn; pick weights or constants"
            )
        parametric, theta = ravel_model(model, select)
        flat = selected_entries(parametric, len(theta), constants)
        count = eqx.filter_eval_shape(residuals, model).shape[0]
        if count <= flat.sum():
            raise InputError(
                f"fit_regression: expected more than {flat.sum()} residuals, one for "
                f"each constant, got {count}"
            )
        # Constants alone are few and well determined: they start hardly damped.
        damped = ChordSteps(1e-2 if flat.all() else 1.0, by_curvature=True)
        return cls(
            parametric=parametric,
            residuals=residuals,
            theta=np.asarray(theta),
            weights=weights_prior,
            names=parameter_names(parametric, len(theta)),
            flat=flat,
            noise=noise,
            scale=scale,
            first_noise=scale,
            least_noise=float(np.finfo(float).eps) * scale,
            tolerance=tolerance,
            step_rule=damped if step_rule is None else step_rule,
            **options,
        )

    def linearise(self, theta: Parameters, states: States) -> AbstractLocalModel | None:
        if self.linearisation is not None:
            right, rows = self.linearisation(self.parametric, theta)
        else:
            inputs = self.residuals, on_device(theta)
            right, rows = map(np.asarray, _linearise(self.parametric, *inputs))
        if not (np.all(np.isfinite(rows)) and np.all(np.isfinite(right))):
            return None
        return LocalRegression(
            quadratic=Quadratic(
                point=theta,
                hessian=rows.T @ rows,
                gradient=rows.T @ right,
                squares=float(right @ right),
                num_free=len(right) - self.num_projected,
                log_determinant=self.log_determinant,
            ),
            problem=self,
            jacobian=rows,
            residuals=on_device(right),
        )

    def residual_series(
        self, step: Step
    ) -> list[Float[np.ndarray, "_ channel"]] | None:
        in_time = getattr(self.residuals, "in_time", None)
        if in_time is None:
            return None
        theta = on_device(step.move.theta)
        residuals = _residuals(self.parametric, self.residuals, theta)
        return in_time(np.asarray(residuals))

    def flat_information(self) -> tuple[int, float]:
        count = eqx.filter_eval_shape(
            self.residuals, self.parametric.at(self.theta)
        ).shape[0]
        total, flat = count - self.num_projected, int(self.flat.sum())
        return total, flat * float(np.log(total)) + self.log_determinant


class LocalRegression(AbstractLocalModel):
    """A regression near one point."""

    quadratic: Quadratic
    problem: Regression
    jacobian: Float[np.ndarray, "residual parameter"]
    residuals: Float[Array, " residual"]

    def predict(self, theta: Parameters) -> Prediction:
        if np.array_equal(theta, self.theta):
            return Prediction(self.residuals, None)
        inputs = self.problem.residuals, on_device(theta)
        return Prediction(_residuals(self.problem.parametric, *inputs), None)

    def pull_back(self, residuals: Float[Array, "..."]) -> Parameters:
        return self.jacobian.T @ np.asarray(residuals)

    def advance(self, mean: Parameters) -> None:
        """There are no states."""

    def defect(self, mean: Parameters, noise: float) -> float:
        """Change of the prediction that the linear model still asks for."""
        if self.problem.is_linear:
            return 0.0
        wanted = np.abs(self.jacobian @ (mean - self.theta)).max()
        allowed = max(SMALL_CHANGE * noise, SMALLEST * self.problem.scale)
        return float(DEFECT_TOLERANCE * wanted / allowed)


@eqx.filter_jit
def _residuals(
    parametric: ParametricModel, residuals: Residuals, theta: Float[Array, " parameter"]
) -> Float[Array, " residual"]:
    return residuals(parametric(theta))


@eqx.filter_jit
def _linearise(
    parametric: ParametricModel, residuals: Residuals, theta: Float[Array, " parameter"]
) -> tuple[Float[Array, " residual"], Float[Array, "residual parameter"]]:
    """Residuals and their Jacobian, some columns at a time."""
    value, push = jax.linearize(lambda at: residuals(parametric(at)), theta)
    # A few tangents at a time: all at once would hold every intermediate result for
    # each parameter.
    columns = jax.lax.map(push, jnp.eye(theta.shape[0]), batch_size=TANGENTS)
    return value, columns.T
