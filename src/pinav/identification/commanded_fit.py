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
from pinav.fitting import (
    Estimate,
    EvidenceFit,
    LinearFit,
    Outcome,
    ravel_model,
)
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
    RollingPropulsion,
    UniformFlow,
    ZeroFlow,
    ZeroForce,
    as_learned,
    tensor_matrix,
)
from pinav.identification.fit import Search
from pinav.identification.likelihood import (
    Design,
    Field,
    Prior,
    block_means,
    compiled_whitened,
)
from pinav.identification.models import CandidateModel
from pinav.identification.systems import (
    DRIFT,
    GAIN,
    PATHS,
    candidate_of,
    natural,
    posterior_over,
    prior_about,
)
from pinav.identification.tracks import Blocks, Track, one_track, padded_to
from pinav.systems import System
from pinav.trajectories import Trajectories

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
        system: the swimmer; its `learn` says which numbers are open.
        data: positions in the plane, with the commands that the propulsion takes.
        environment: untrained kernels; None fits the numbers and the noise alone,
            for comparison of the evidence.
        refine: when kernels turn out too coarse, and finer ones are laid.
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
            if not refine.wanted(environment, shape):
                return fit
            finer = refine.finer(environment, data)
            if finer is None:
                return dataclasses.replace(fit, outcome=Outcome.UNDER_RESOLVED)
            environment = finer


class _Problem:
    """The linear problem at given noise, and the search for the noise."""

    def __init__(
        self,
        system: System,
        track: Track,
        environment: AbstractLearnedForce | None,
    ):
        self.candidate, stated = candidate_of(system)
        wide = Prior.of(track)
        prior = prior_about(stated, wide)
        swimmer = _with_environment(system.swimmer, environment)
        design = Design.of(self.candidate, Blocks.of(track))
        # The propulsion is a force: what the gain moves passes through the mobility.
        mobility = tensor_matrix(swimmer.mobility, jnp.zeros(2))
        gains = jnp.einsum("ab,gbc->gac", mobility, design.gains)
        self.design = eqx.tree_at(lambda d: d.gains, design, gains)
        self.swimmer, self.environment = swimmer, environment
        self.field = _field(swimmer, self.candidate, self.design.blocks, mobility)
        self.weights: AbstractWeights = NoWeights()
        if environment is not None:
            self.weights = GaussianWeights(environment.prior())
        self.search = Search(self.design, self.candidate, prior)
        # What is stated and not open stays as it is stated, noise not stated does not.
        self.search.base = np.where(np.isfinite(stated), stated, prior.mean)

    def quadratic(self, learned: np.ndarray) -> tuple[Quadratic, FlatBlock, float]:
        """Squares as a function of the weights, coefficients integrated out."""
        theta = jnp.asarray(self.search.theta(learned))
        problem = compiled_whitened(theta, self.design, self.field)
        rows = np.asarray(problem.rows)
        present = np.any(rows != 0, axis=0)
        columns = np.concatenate([rows[:, present], np.asarray(problem.field)], axis=1)
        target = np.asarray(problem.target)
        count, flat = int(problem.count), int(present.sum())
        if flat < self.candidate.num_linear:
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
        information = 2 * float(problem.log_variance) + flat * np.log(2 * count)
        return reduced, block, information

    def infer(self, learned: np.ndarray, shape: np.ndarray) -> Inference:
        """Prior of the field of highest evidence at this noise, and the weights."""
        return self.weights.infer(self.quadratic(learned)[0], shape, 1.0)

    def with_prior_of(self, learned: np.ndarray, inference: Inference) -> Search:
        """The search for the noise, the weights of the field integrated out."""
        self.search.field = self.field
        if isinstance(self.weights, GaussianWeights):
            chosen = inference.hyperparameters
            covariance = self.weights.prior.covariance(chosen.shape)
            hessian = self.quadratic(learned)[0].hessian
            root = _informed_root(chosen.amplitude**2 * covariance, hessian)
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

    slopes = problem.search.slopes(learned, conditional_mean)
    cross = slopes @ spread
    unknown = np.concatenate([learned, mean])
    covariance = np.block([[spread, cross.T], [cross, alone + cross @ slopes.T]])
    numbers = _numbers(problem, unknown)
    rows = np.concatenate([number.slopes for number in numbers])
    posterior = posterior_over(
        problem.swimmer,
        [number.path for number in numbers],
        {number.path: number.values for number in numbers},
        rows @ covariance @ rows.T,
    )
    quadratic, _, information = problem.quadratic(learned)
    log_prior = _log_prior(problem.search, learned)
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
        constants=_constants(problem, numbers, unknown, covariance),
        states=None,
        goodness=None,
        linear=linear,
    )


def _log_prior(search: Search, learned: np.ndarray) -> float:
    sd = search.prior.sd[search.places]
    offset = (learned - search.prior.mean[search.places]) / sd
    constant = np.log(sd).sum() + 0.5 * len(sd) * np.log(2 * np.pi)
    return float(-0.5 * offset @ offset - constant)


class _Number(eqx.Module):
    """Learned numbers of a swimmer: a gain matrix, a delay, all weights.

    Attributes:
        path: where they stand, or the name of a parameter of the noise.
        values: flattened.
        slopes: derivatives by nonlinear parameters, present coefficients and weights.
    """

    path: str = eqx.field(static=True)
    values: Float[np.ndarray, " number"]
    slopes: Float[np.ndarray, "number unknown"]


def _numbers(problem: _Problem, unknown: np.ndarray) -> list[_Number]:
    """Numbers of the swimmer; the unknowns in the order of `_Number.slopes`."""
    candidate = problem.candidate
    numbers = [
        _nonlinear(PATHS[name], name, index, unknown)
        for index, name in enumerate(candidate.learned)
        if name in PATHS
    ]
    first = len(candidate.learned)
    linear = [(GAIN, np.reshape(candidate.gains, (-1, 4)))] if candidate.gains else []
    if candidate.drifts:
        linear.append((DRIFT, np.reshape(candidate.drifts, (-1, 2))))
    for path, basis in linear:
        slopes = np.zeros((basis.shape[1], len(unknown)))
        slopes[:, first : first + len(basis)] = basis.T
        numbers.append(_Number(path, slopes @ unknown, slopes))
        first += len(basis)
    if problem.environment is not None:
        slopes = np.eye(len(unknown))[first:]
        numbers.append(_Number(WEIGHTS, unknown[first:], slopes))
    return numbers


WEIGHTS = "environment"
"""Path of all weights of the environment."""


def _nonlinear(path: str, name: str, index: int, unknown: np.ndarray) -> _Number:
    """A nonlinear parameter in the units of a system."""
    at = jnp.asarray(unknown[index])
    slopes = np.zeros((1, len(unknown)))
    slopes[0, index] = jax.grad(lambda value: natural(name, value))(at)
    return _Number(path, np.asarray(natural(name, at)).reshape(1), slopes)


def _constants(
    problem: _Problem,
    numbers: list[_Number],
    unknown: np.ndarray,
    covariance: np.ndarray,
) -> dict[str, Estimate]:
    """Numbers of the swimmer and of its noise by name."""
    noise = [
        _nonlinear(NOISE_PATHS[name], name, index, unknown)
        for index, name in enumerate(problem.candidate.learned)
        if name in NOISE_PATHS
    ]
    estimates = {}
    for number in (*numbers, *noise):
        if number.path == WEIGHTS:
            continue
        spread = number.slopes @ covariance @ number.slopes.T
        deviations = np.sqrt(np.maximum(np.diag(spread), 0.0))
        several = zip(number.values, deviations, strict=True)
        for index, (value, sd) in enumerate(several):
            label = _label(number.path, index, len(deviations))
            estimates[label] = Estimate(float(value), float(sd))
    return estimates


def _label(path: str, index: int, count: int) -> str:
    """The path of one number: entries of a matrix or a vector by their place."""
    places = {1: "", 2: f"[{index}]", 4: f"[{index // 2}, {index % 2}]"}
    return path + places[count]


NOISE_PATHS = {
    "log_still": "wandering.still",
    "log_driven": "wandering.driven",
    "log_memory": "wandering.memory",
    "log_slow": "wandering.slow",
    "log_slow_memory": "wandering.slow_memory",
    "log_noise": "noise of a block",
}
"""Names of the parameters of the noise among the constants of a fit."""


def _informed_root(covariance: np.ndarray, hessian: np.ndarray) -> np.ndarray:
    """Directions of unit prior variance of which the data tell anything.

    A smooth prior has hundreds of weights and some tens of such directions; only they
    pass through the filter at each step of the search for the noise.
    """
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    signal, turned = np.linalg.eigh(root.T @ hessian @ root)
    kept = signal > LEAST_SIGNAL
    columns = root @ turned[:, kept]
    # Widths in round numbers: one compiled likelihood serves all rounds.
    return np.pad(columns, ((0, 0), (0, padded_to(columns.shape[1], 16) - kept.sum())))


LEAST_SIGNAL = 1e-3
"""Information of the data on a direction, in units of its prior, that counts."""


def _with_environment(
    swimmer: Any, environment: AbstractLearnedForce | None
) -> OverdampedSwimmer:
    if isinstance(swimmer.flow, ZeroFlow):
        swimmer = eqx.tree_at(lambda s: s.flow, swimmer, UniformFlow(jnp.zeros(2)))
    return swimmer if environment is None else swimmer.with_environment(environment)


def _field(
    swimmer: OverdampedSwimmer,
    candidate: CandidateModel,
    blocks: Blocks,
    mobility: Float[Array, "2 2"],
) -> Field:
    """Displacements by the weights of the environment and by what is known."""
    nothing = Field.nothing(blocks)
    gain, drift = nothing.gain, nothing.drift
    propulsion, flow = swimmer.propulsion, swimmer.flow
    if isinstance(propulsion, RollingPropulsion) and not candidate.gains:
        gain = mobility @ propulsion.gain
    if isinstance(flow, UniformFlow):
        drift = drift if candidate.drifts else flow.velocity
        flow = ZeroFlow()
    passive = eqx.tree_at(
        lambda s: (s.propulsion, s.environment, s.flow),
        swimmer,
        (ZeroForce(), ZeroForce(), flow),
    )
    columns = nothing.columns
    environment = as_learned(swimmer.environment)
    if environment is not None:
        free, start = ravel_model(environment, lambda e: e.parameters)
        columns = _weight_columns(free, jnp.zeros_like(start), swimmer, blocks)
    return Field(columns, _displacement(passive, blocks), gain, drift)


@eqx.filter_jit
def _weight_columns(free, theta, swimmer, blocks) -> Float[Array, "block 2 weight"]:
    """Mean displacement in each block for each weight."""

    def along(theta: Float[Array, " weight"]) -> Float[Array, "block 2"]:
        environment = free(theta)

        def velocity(t, x):
            return swimmer.mobility(x, environment(t, x, jnp.zeros_like(x)))

        return _displacement(velocity, blocks)

    _, linear = jax.linearize(along, theta)
    # A few weights at a time: all of them at every sample would take gigabytes.
    columns = jax.lax.map(linear, jnp.eye(theta.shape[0]), batch_size=32)
    return jnp.moveaxis(columns, 0, -1)


def _displacement(velocity, blocks: Blocks) -> Float[Array, "block 2"]:
    """Block means of a velocity field integrated along the observed path."""
    rates = jax.vmap(velocity)(blocks.times, blocks.positions)
    middle = (rates[1:] + rates[:-1]) / 2
    # Leaps between segments add a constant, which the filter forgets at each begin.
    steps = middle * jnp.diff(blocks.times)[:, None]
    path = jnp.concatenate([jnp.zeros((1, 2)), jnp.cumsum(steps, axis=0)])
    return block_means(path, blocks)
