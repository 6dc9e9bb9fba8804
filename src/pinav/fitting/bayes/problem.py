"""A fit of trajectories by multiple shooting: its parameters, start and residuals."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from pinav.arguments import on_device
from pinav.dynamics import FixedStep
from pinav.errors import FitError, InputError
from pinav.fitting.bayes.parameters import (
    Learn,
    check_learned,
    constant_priors,
    geometry_leaves,
    learned_environment,
    num_positions,
    parametrise,
    weight_leaves,
)
from pinav.fitting.engine.local_model import (
    AbstractLocalModel,
    ConstantPriors,
    ParametricModel,
    Prediction,
    parameter_names,
    selected_entries,
)
from pinav.fitting.engine.multiple_shooting import (
    Linearisation,
    advance,
    linearise,
    predict,
    pull_back,
)
from pinav.fitting.engine.problem import (
    AbstractProblem,
    AbstractStepRule,
    ChordSteps,
    FullStep,
    ShortenedStep,
    Step,
)
from pinav.fitting.evidence.model_evidence import LinearFit
from pinav.fitting.evidence.quadratic import Parameters, Quadratic
from pinav.fitting.evidence.weights import AbstractWeights, GaussianWeights, NoWeights
from pinav.fitting.matching.state import Observations
from pinav.trajectories import Trajectories, smooth_states

States = Float[Array, "trajectory time state"]


class LocalTrajectories(AbstractLocalModel):
    """Trajectories about states that need not fulfil the dynamics.

    Attributes:
        quadratic: the sum of squares, the starts eliminated.
    """

    quadratic: Quadratic
    problem: "BayesProblem"
    states: States
    linear: Linearisation

    def predict(self, theta: Parameters) -> Prediction:
        whole = self.problem
        inputs = on_device(theta), self.states, whole.observations, whole.solver
        return predict(whole.parametric, *inputs)

    def pull_back(self, residuals: Float[Array, "..."]) -> Parameters:
        return np.asarray(pull_back(self.linear, residuals))

    def advance(self, mean: Parameters) -> States:
        return advance(self.states, self.linear, on_device(mean - self.theta))

    def defect(self, mean: Parameters, noise: float) -> float:
        """The largest defect, relative to the spread of its channel."""
        return float(np.max(np.asarray(self.linear.defects) / self.problem.scale))


class BayesProblem(AbstractProblem):
    """The start of a fit of trajectories, and what does not change while it runs.

    Attributes:
        scale: spread of each channel.
        least_noise: none: an honest fit of exact data ends at rounding.
    """

    parametric: ParametricModel
    theta: Parameters
    states: Float[Array, "trajectory time state"] | None
    weights: AbstractWeights
    priors: ConstantPriors
    step_rule: AbstractStepRule
    tolerance: float
    names: tuple[str, ...]
    flat: Bool[np.ndarray, " parameter"]
    noise: float | None
    first_noise: float
    observations: Observations
    scale: Float[np.ndarray, " state"]
    solver: FixedStep
    teacher: LinearFit | None = None
    visited: Float[np.ndarray, "place dim"] | None = None
    least_noise: float = 0.0

    @classmethod
    def of(
        cls,
        model: Any,
        trajectories: Trajectories,
        learn: Learn,
        noise: float | None,
        solver: FixedStep,
        *,
        states: States | Float[np.ndarray, "trajectory time state"] | None = None,
        weights: AbstractWeights | None = None,
        teacher: LinearFit | None = None,
    ) -> "BayesProblem":
        """The problem of a model and trajectories; see `fit_bayes`."""
        parametric, theta = parametrise(model, learn)
        names = parameter_names(parametric, len(theta))
        flat = ~selected_entries(parametric, len(theta), weight_leaves)
        shaping = selected_entries(parametric, len(theta), geometry_leaves)
        check_learned(model, names, flat & ~shaping)
        dim = num_positions(model, trajectories)
        states = smooth_states(trajectories, dim) if states is None else states
        priors = constant_priors(model, parametric, np.asarray(theta), learn)
        equations = trajectories.num_observed + len(priors.entries)
        if equations - states[:, 0].size <= flat.sum():
            raise InputError(
                f"fit_bayes trajectories: {trajectories.num_observed} observations "
                "are no more than the starts and constants to be found; add samples"
            )
        if learn is None:
            weights, rule, tolerance = NoWeights(), FullStep(), TOLERANCE
        else:
            weights, rule, tolerance = _method(
                model, weights, bends=bool(shaping.any())
            )
        residuals = (np.asarray(states) - trajectories.states)[trajectories.observed]
        return cls(
            parametric=parametric,
            theta=np.asarray(theta),
            states=on_device(states),
            weights=weights,
            priors=priors,
            step_rule=rule,
            tolerance=tolerance,
            names=names,
            flat=flat,
            noise=noise,
            first_noise=float(np.sqrt(np.mean(residuals**2))),
            observations=Observations.of(trajectories, jnp.float64),
            scale=_spread(states, trajectories.lengths),
            solver=solver,
            teacher=teacher,
            visited=trajectories.seen_positions,
        )

    @property
    def num_free(self) -> int:
        """Observations less starts."""
        observed = np.asarray(self.observations.observed)
        return int(observed.sum()) - len(observed) * len(self.scale)

    def linearise(
        self, theta: Parameters, states: Any
    ) -> AbstractLocalModel | None:  # with dynamics there are states
        linear = linearise(
            self.parametric, on_device(theta), states, self.observations, self.solver
        )
        if not np.all(np.isfinite(linear.start_factor)):
            return None
        _check_starts(linear)
        if not np.all(np.isfinite(linear.hessian)):
            return None
        diagonals = np.diagonal(np.asarray(linear.start_factor), axis1=1, axis2=2)
        return LocalTrajectories(
            quadratic=Quadratic(
                theta,
                np.asarray(linear.hessian),
                np.asarray(linear.gradient),
                float(linear.squares),
                num_free=self.num_free,
                log_determinant=2 * float(np.log(np.abs(diagonals)).sum()),
            ),
            problem=self,
            states=states,
            linear=linear,
        )

    def residual_series(
        self, step: Step
    ) -> list[Float[np.ndarray, "_ channel"]] | None:
        if step.hyperparameters.noise < LEAST_NOISE * self.scale.max():
            return None  # what is left is the integrator's error, and never white
        data = self.observations
        residuals = np.asarray(step.move.states) - np.asarray(data.states)
        return list(np.where(np.asarray(data.observed), residuals, np.nan))

    def flat_information(self) -> tuple[int, float]:
        counts = np.asarray(self.observations.observed).sum(axis=(1, 2))
        total, state = int(counts.sum()), len(self.scale)
        starts = state * float(np.log(counts).sum())
        return total, starts + float(self.flat.sum() * np.log(total))


def _method(
    model: Any, weights: AbstractWeights | None, *, bends: bool
) -> tuple[AbstractWeights, AbstractStepRule, float]:
    """Prior of the weights, steps as curved as they are, and when to stop.

    Args:
        bends: True if the geometry of terms is learned, in which forces are not linear.
    """
    environment = learned_environment(model)
    if weights is not None:
        return weights, ShortenedStep(), NETWORK_TOLERANCE
    if environment is None:
        return NoWeights(), ChordSteps(damping=1e-2), TOLERANCE
    weights = GaussianWeights(environment.prior())
    if environment.is_linear:
        return weights, ShortenedStep() if bends else FullStep(), TOLERANCE
    return weights, ChordSteps(damping=1e3), NETWORK_TOLERANCE


LEAST_NOISE = 1e-4
"""Noise relative to the spread of the data, below which the data count as exact."""

TOLERANCE, NETWORK_TOLERANCE = 1e-2, 2.0
"""Change of the log evidence at which a fit ends. That of a network goes on to creep
while weights shrink on which the data do not depend."""


def _spread(
    states: Float[Any, "trajectory time state"], lengths: Any
) -> Float[np.ndarray, " state"]:
    """Standard deviation of each channel over all samples; 1 where it is constant."""
    samples = np.concatenate(
        [own[:length] for own, length in zip(states, lengths, strict=True)]
    )
    spread = samples.std(axis=0)
    return np.where(spread > 0, spread, 1.0)


def _check_starts(linear: Linearisation) -> None:
    for index, factor in enumerate(np.asarray(linear.start_factor)):
        lengths = np.linalg.norm(factor, axis=0)
        scaled = factor / np.where(lengths > 0, lengths, 1.0)
        values = np.linalg.svd(scaled, compute_uv=False)
        if values[-1] < 1e-13 * values[0]:
            raise FitError(
                f"the fit is singular: the observations of trajectory {index} do not "
                "determine its start; drop the trajectory"
            )
