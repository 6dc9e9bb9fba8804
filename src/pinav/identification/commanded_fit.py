r"""`fit_commanded`: a field of position beside commands and a wandering velocity.

The displacement of a swimmer between two blocks of time is the integral of the
propulsion along its commands, of the drift, of the environment's velocity along the
observed path, and of a wandering Ornstein-Uhlenbeck velocity. A Kalman filter whitens
it; gain, drift and the weights of the environment are then linear, and one likelihood
decides about all of them. The noise is chosen with the field present: a wandering
velocity that was chosen without it has taken a part of the force.

The path is the observed one: its localisation error must be small against the length
over which the field varies.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.dynamics import OverdampedSwimmer
from pinav.errors import FitError, InputError
from pinav.fitting import EvidenceFit, LinearFit, Outcome, ravel_model
from pinav.fitting.environments.refinement import AS_FINE_AS_ASKED, Refinement
from pinav.fitting.evidence.quadratic import (
    FlatBlock,
    Quadratic,
    eliminate_flat,
    joint_posterior,
)
from pinav.fitting.evidence.weights import (
    AbstractWeights,
    GaussianWeights,
    Inference,
    NoWeights,
)
from pinav.forces import (
    AbstractLearnedForce,
    UniformFlow,
    ZeroFlow,
    ZeroForce,
    as_learned_force,
)
from pinav.identification.drive import is_open
from pinav.identification.fit import CandidateSearch, stated_coordinates
from pinav.identification.likelihood import Design, Field, path_displacement, whiten
from pinav.identification.parameters import DRIFT, GAIN, Prior
from pinav.identification.tracks import Blocks, Track, one_track, round_up_to
from pinav.systems import System
from pinav.trajectories import Trajectories


def determined_directions(covariance: np.ndarray, hessian: np.ndarray) -> np.ndarray:
    """Directions of unit prior variance that the data determine.

    A smooth prior has hundreds of weights and some tens of such directions; only they
    pass through the filter at each step of the search for the noise.
    """
    # A smooth prior is singular to rounding, where a Cholesky factor fails.
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    signal, turned = np.linalg.eigh(root.T @ hessian @ root)
    kept = signal > LEAST_SIGNAL
    columns = root @ turned[:, kept]
    # Widths in round numbers: one compiled likelihood serves all rounds.
    return np.pad(
        columns, ((0, 0), (0, round_up_to(columns.shape[1], 16) - kept.sum()))
    )


LEAST_SIGNAL = 1e-3
"""Information of the data on a direction, in units of its prior, that counts."""


def with_environment(
    swimmer: Any, environment: AbstractLearnedForce | None
) -> OverdampedSwimmer:
    """The swimmer with an environment, and a uniform flow that may be learned."""
    if isinstance(swimmer.flow, ZeroFlow):
        swimmer = eqx.tree_at(lambda s: s.flow, swimmer, UniformFlow(jnp.zeros(2)))
    return swimmer if environment is None else swimmer.with_environment(environment)


def displacements_by(
    swimmer: OverdampedSwimmer,
    blocks: Blocks,
    *,
    drift: bool,
) -> Field:
    """Displacements by the weights of the environment and by what is known."""
    nothing = Field.nothing(blocks)
    known_drift, flow = nothing.drift, swimmer.flow
    if isinstance(flow, UniformFlow):
        known_drift = known_drift if drift else flow.velocity
        flow = ZeroFlow()
    passive = eqx.tree_at(
        lambda s: (s.propulsion, s.environment, s.flow),
        swimmer,
        (ZeroForce(), ZeroForce(), flow),
    )
    columns = nothing.columns
    environment = as_learned_force(swimmer.environment)
    if environment is not None:
        free, start = ravel_model(environment, lambda e: e.parameters)
        columns = _weight_columns(free, jnp.zeros_like(start), swimmer, blocks)
    return Field(columns, path_displacement(passive, blocks), known_drift)


@eqx.filter_jit
def _weight_columns(
    free: Any, theta: Array, swimmer: OverdampedSwimmer, blocks: Blocks
) -> Float[Array, "block 2 weight"]:
    """Mean displacement in each block for each weight."""

    def along(theta: Float[Array, " weight"]) -> Float[Array, "block 2"]:
        environment = free(theta)

        def velocity(t: Array, x: Array) -> Array:
            return swimmer.mobility(x, environment(t, x, jnp.zeros_like(x)))

        return path_displacement(velocity, blocks)

    # Exact at any point, as the force is linear in its weights.
    _, linear = jax.linearize(along, theta)
    # A few weights at a time: all of them at every sample would take gigabytes.
    columns = jax.lax.map(linear, jnp.eye(theta.shape[0]), batch_size=32)
    return jnp.moveaxis(columns, 0, -1)


ROUNDS = 12
"""Rounds at most in which noise and prior of the field are chosen in turn."""

TOLERANCE = 0.05
"""Change of the log evidence at which the rounds end [nats]."""


def fit_commanded(
    system: System,
    data: Trajectories,
    environment: AbstractLearnedForce | None,
    *,
    refine: Refinement | None = AS_FINE_AS_ASKED,
    on_round: Callable[[int, float], None] | None = None,
) -> EvidenceFit:
    """Fit a field, the open numbers of a system and its noise to positions.

    Priors of the system's numbers are used as starts only, and as wide as those of
    `identify`: a system that was identified from the same data must not count them
    twice.

    Args:
        data: positions in the plane, with the commands that the propulsion takes.
        environment: untrained kernels; None fits the numbers and the noise alone,
            for comparison of the evidence.
        refine: rule that refines kernels which are too coarse.
        on_round: called with the number of rounds done and the log evidence.

    Raises:
        InputError: the system, the data or the environment are not of this kind.
        FitError: the likelihood is not finite.
    """
    if environment is not None and not (
        environment.is_linear and environment.is_static
    ):
        raise InputError(
            "fit_commanded environment: expected kernels that do not change with time, "
            f"got {type(environment).__name__}; choose kernel-force, kernel-potential "
            "or kernel-mixture"
        )
    with jax.enable_x64(new_val=True):
        while True:
            fit, shape = _fit(system, data, environment, on_round)
            if environment is None or refine is None:
                return fit
            if not refine.is_needed(environment, shape):
                return fit
            finer = refine.finer(environment, data)
            if finer is None:
                return dataclasses.replace(fit, outcome=Outcome.UNDER_RESOLVED)
            environment = finer


class _Problem:
    """The linear problem at given noise, and the search for the noise."""

    def __init__(
        self, system: System, track: Track, environment: AbstractLearnedForce | None
    ) -> None:
        if not isinstance(system.swimmer, OverdampedSwimmer):
            raise InputError(
                f"system {system.name!r}: expected a swimmer without inertia (order 1) "
                "for a fit with commands or a wandering velocity, got order 2"
            )
        self.design = design = Design.of(system, Blocks.of(track))
        learnable = {GAIN, DRIFT, *(number.path for number in design.parameters)}
        if ignored := {number.path for number in system.learn} - learnable:
            raise InputError(
                f"system {system.name!r} learn: {', '.join(sorted(ignored))} cannot be "
                "learned beside commands or a wandering velocity; state it in the "
                "system and drop it from the table [learn]"
            )
        # Priors of a system are used where nothing else tells the scale of a number.
        own = [parameter.prior is not None for parameter in design.parameters]
        stated = np.where(own, np.nan, stated_coordinates(system, design))
        prior = Prior.of(track, design.parameters).about(stated)
        self.swimmer = with_environment(system.swimmer, environment)
        self.field = displacements_by(
            self.swimmer, design.blocks, drift=is_open(system, DRIFT)
        )
        self.weights: AbstractWeights = NoWeights()
        if environment is not None:
            self.weights = GaussianWeights(environment.prior())
        self.search = CandidateSearch(system, self.design, prior)

    def quadratic(self, learned: np.ndarray) -> tuple[Quadratic, FlatBlock, float]:
        """Squares as a function of the weights, coefficients integrated out."""
        theta = jnp.asarray(self.search.theta(learned))
        problem = whiten(theta, self.design.regressors(theta), self.field)
        rows = np.asarray(problem.rows)
        present = np.any(rows != 0, axis=0)
        columns = np.concatenate([rows[:, present], np.asarray(problem.field)], axis=1)
        target = np.asarray(problem.target)
        count, flat = int(problem.count), int(present.sum())
        if flat < int(self.search.present.sum()):
            raise InputError(
                "fit_commanded data: the commands ask for no motion, so that the gain "
                "cannot be learned; give data that are driven, or drop "
                f"{GAIN!r} from the table [learn] of the system"
            )
        full = Quadratic(
            point=np.zeros(columns.shape[1]),
            hessian=columns.T @ columns,
            gradient=-columns.T @ target,
            squares=float(target @ target),
            num_free=2 * count,
            log_determinant=2 * float(problem.log_variance),
        )
        reduced, block = eliminate_flat(full, np.arange(columns.shape[1]) < flat)
        # A coefficient costs half the logarithm of the number of observations, as its
        # prior holds the information of one.
        information = 2 * float(problem.log_variance) + flat * np.log(2 * count)
        return reduced, block, information

    def infer(self, learned: np.ndarray, shape: np.ndarray) -> Inference:
        """Prior of the field of highest evidence at this noise, and the weights."""
        return self.weights.infer(self.quadratic(learned)[0], shape, 1.0)

    def with_prior_of(
        self, learned: np.ndarray, inference: Inference
    ) -> CandidateSearch:
        """The search for the noise, the weights of the field integrated out."""
        self.search.field = self.field
        if isinstance(self.weights, GaussianWeights):
            chosen = inference.hyperparameters
            covariance = self.weights.prior.covariance(chosen.shape)
            hessian = self.quadratic(learned)[0].hessian
            root = determined_directions(chosen.amplitude**2 * covariance, hessian)
            # Columns of unit prior variance, in the directions that the data determine.
            columns = self.field.columns @ jnp.asarray(root)
            self.search.field = eqx.tree_at(
                lambda field: field.columns, self.field, columns
            )
        return self.search

    def joint(
        self, learned: np.ndarray, inference: Inference
    ) -> tuple[np.ndarray, np.ndarray]:
        """Mean and covariance of coefficients and weights at this noise."""
        quadratic, block, _ = self.quadratic(learned)
        chosen = inference.hyperparameters
        mean, covariance = self.weights.posterior(quadratic, chosen)
        extra = self.weights.shape_covariance(quadratic, chosen, 1.0)
        return joint_posterior(block, mean, covariance + extra, 1.0)


def _fit(
    system: System,
    data: Trajectories,
    environment: AbstractLearnedForce | None,
    on_round: Callable[[int, float], None] | None,
) -> tuple[EvidenceFit, Float[np.ndarray, " shape"]]:
    problem = _Problem(system, one_track(data, system.name), environment)
    learned = problem.search.base[problem.search.places]
    inference, before = problem.infer(learned, problem.weights.start), -np.inf
    done = 0
    while True:
        done += 1
        shape = inference.hyperparameters.shape
        learned, value = problem.with_prior_of(learned, inference).descend(learned)
        if not np.isfinite(value):
            raise FitError(
                f"system {system.name!r}: the likelihood is not finite; check the "
                "times and units of the data"
            )
        if on_round:
            on_round(done, -value)
        converged = abs(-value - before) < TOLERANCE
        if converged or done == ROUNDS:
            outcome = Outcome.CONVERGED if converged else Outcome.STALLED
            return _result(problem, learned, inference, outcome, done), shape
        inference, before = problem.infer(learned, shape), -value


def _result(
    problem: _Problem,
    learned: np.ndarray,
    inference: Inference,
    outcome: Outcome,
    rounds: int,
) -> EvidenceFit:
    spread, volume = problem.search.laplace(learned)
    inference = problem.infer(learned, inference.hyperparameters.shape)
    mean, alone = problem.joint(learned, inference)
    chosen = inference.hyperparameters

    def conditional_mean(place: np.ndarray) -> np.ndarray:
        quadratic, block, _ = problem.quadratic(place)
        weights, covariance = problem.weights.posterior(quadratic, chosen)
        return joint_posterior(block, weights, covariance, 1.0)[0]

    posterior, constants = problem.search.joint_posterior(
        problem.swimmer, learned, spread, conditional_mean, alone
    )
    quadratic, _, information = problem.quadratic(learned)
    log_prior, _ = problem.search.log_prior(learned)
    linear = LinearFit(
        quadratic=quadratic,
        weights=problem.weights,
        noise=1.0,
        num_observed=quadratic.num_free + len(mean) - len(inference.mean),
        flat_information=information - 2 * (volume + log_prior),
    )
    return EvidenceFit(
        model=posterior.model,
        outcome=outcome,
        iterations=rounds,
        hyperparameters=chosen,
        posterior=posterior,
        constants=constants,
        states=None,
        goodness=None,
        linear=linear,
    )
