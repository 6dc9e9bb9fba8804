"""A position-dependent residual on top of a candidate: kernels, a potential, a network.

The noise of the candidate is held. Along the observed path the residual's velocity is
integrated and filtered like any regressor, gain and drift are projected out, and the
evidence chooses the prior of the weights, as `fit_bayes` chooses it.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.dynamics import OverdampedSwimmer
from pinav.fitting import EvidenceFit, model_evidence
from pinav.fitting.engine.evidence_fit import evidence_fit, iterate
from pinav.fitting.engine.problem import FullStep, ShortenedStep
from pinav.fitting.evidence.weights import GaussianWeights
from pinav.fitting.least_squares import Regression
from pinav.identification import likelihood
from pinav.identification.forecast import Displacement, integrate_held, path_of
from pinav.identification.parameters import fitted_coordinates
from pinav.identification.rollouts import Errors, Rollouts
from pinav.identification.tracks import Blocks, Track
from pinav.systems import System
from pinav.trajectories import Trajectories, Trajectory

NETWORK_STEPS = 5
"""Gauss-Newton steps of a network; kernels need one."""


class ResidualFit(eqx.Module):
    """A candidate in a residual velocity field, a force under mobility 1."""

    swimmer: OverdampedSwimmer
    log_evidence: float


def positions_of(track: Track) -> Trajectories:
    """The positions of a track as trajectories, for laying kernels."""
    return Trajectories.from_arrays(
        [piece.times for piece in track.pieces],
        [piece.states for piece in track.pieces],
        channels=("x", "y"),
    )


def fit_residual(
    track: Track, system: System, base: EvidenceFit, environment: Any
) -> ResidualFit:
    """Fit the weights of an environment to what a candidate leaves."""
    with jax.enable_x64(new_val=True):
        design = likelihood.Design.of(system, Blocks.of(track))
        theta = jnp.asarray(fitted_coordinates(base, design.parameters))
        regressors = design.regressors(theta)
        whitened = likelihood.whiten(theta, regressors)
        present = np.any(np.asarray(whitened.rows) != 0, axis=0)
        rows = np.asarray(whitened.rows)[:, present]
        basis = jnp.asarray(np.linalg.qr(rows)[0])
        residuals = FilteredDisplacement(
            theta, design.blocks, regressors, whitened.target, basis
        )
        num_free = 2 * int(whitened.count) - rows.shape[1]
        linear = environment.is_linear
        problem = Regression.of(
            environment,
            residuals,
            weights=lambda model: model.parameters,
            weights_prior=GaussianWeights(environment.prior()),
            noise=1.0,
            step_rule=FullStep() if linear else ShortenedStep(),
            is_linear=linear,
            num_projected=len(whitened.target) - num_free,
        )
        outcome, steps = iterate(problem, 1 if linear else NETWORK_STEPS)
        field = evidence_fit(
            problem, outcome, steps, not_finite="its velocity is not finite", advice={}
        )
        gain = model_evidence(field.linear, field.hyperparameters).log_evidence
        target = residuals.project(residuals.target)
        nothing = -0.5 * (num_free * np.log(2 * np.pi) + float(jnp.sum(target**2)))
        moved = eqx.filter_jit(residuals.displacement)(field.model)
        left = np.asarray(residuals.target - moved)
        numbers = np.linalg.lstsq(rows, left, rcond=None)[0]
        swimmer = _with_linear(base.model, *np.split(numbers, [present[:4].sum()]))
        return ResidualFit(
            swimmer=swimmer.with_environment(field.model),
            log_evidence=base.hyperparameters.log_evidence + float(gain - nothing),
        )


def _with_linear(
    swimmer: OverdampedSwimmer,
    gain: Float[np.ndarray, " number"],
    drift: Float[np.ndarray, " number"],
) -> OverdampedSwimmer:
    """The swimmer with another gain and drift, where it has such numbers."""
    if len(gain):
        propulsion: Any = swimmer.propulsion
        shaped = jnp.asarray(gain).reshape(propulsion.gain.shape)
        swimmer = eqx.tree_at(lambda s: s.propulsion.gain, swimmer, shaped)
    if len(drift):
        velocity = jnp.asarray(drift)
        swimmer = eqx.tree_at(lambda s: s.flow.velocity, swimmer, velocity)
    return swimmer


class FilteredDisplacement(eqx.Module):
    """Whitened residuals for an environment, orthogonal to gain and drift."""

    theta: Float[Array, " parameter"]
    blocks: Blocks
    regressors: likelihood.Regressors
    target: Float[Array, " row"]
    basis: Float[Array, "row coefficient"]

    def displacement(self, environment: Any) -> Float[Array, " row"]:
        """Integral of the environment's velocity along the path, filtered."""
        moved = likelihood.path_displacement(
            lambda t, x: environment(t, x, jnp.zeros_like(x)), self.blocks
        )
        filtered = self.regressors.filter(
            self.theta, likelihood.in_plane(moved)[:, None]
        )
        return likelihood.apart(filtered.columns[:, 0])

    def __call__(self, environment: Any) -> Float[Array, " row"]:
        """Displacements by the environment less the observed ones."""
        return self.project(self.displacement(environment) - self.target)

    def project(self, values: Float[Array, " row"]) -> Float[Array, " row"]:
        """The part of values that gain and drift cannot explain."""
        return values - self.basis @ (self.basis.T @ values)


def path_along(fit: ResidualFit) -> Displacement:
    """Displacements by a candidate and its residual along the observed positions."""
    path = path_of(fit.swimmer)

    def displacement(piece: Trajectory) -> Float[np.ndarray, "time 2"]:
        at = jax.vmap(lambda x: fit.swimmer.environment(0.0, x, 0 * x))
        velocity = np.asarray(at(jnp.asarray(piece.states)))
        return path(piece) + integrate_held(velocity, piece.times)

    return displacement


def residual_errors(track: Track, rollouts: Rollouts, fit: ResidualFit) -> Errors:
    """End-point errors of rollouts in which the residual acts along the way."""
    path_to, distance = path_of(fit.swimmer), [np.zeros(0)]
    for index, piece in enumerate(track.pieces):
        chosen = np.flatnonzero(rollouts.piece == index)
        if len(chosen):
            ends = rollouts.first[chosen], rollouts.last[chosen]
            reached = _roll_out(fit.swimmer.environment, piece, path_to(piece), ends)
            distance.append(np.hypot(*(reached - piece.states[ends[1]]).T))
    return Errors.of(np.concatenate(distance), rollouts.lengths(track))


def _roll_out(
    environment: Any,
    piece: Trajectory,
    path: np.ndarray,
    ends: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """Ends of rollouts by the midpoint rule, from frame to frame."""
    first, last = ends
    count = int((last - first).max())
    index = np.minimum(first[:, None] + np.arange(count + 1), last[:, None])
    steps = np.diff(path[index], axis=1)
    intervals = np.diff(piece.times[index], axis=1)
    inputs = map(jnp.asarray, (piece.states[first], steps, intervals))
    return np.asarray(_integrate(environment, *inputs))


@eqx.filter_jit
def _integrate(
    environment: Any, starts: Array, steps: Array, intervals: Array
) -> Array:
    velocity = jax.vmap(lambda x: environment(0.0, x, jnp.zeros_like(x)))

    def step(x: Array, inputs: tuple[Array, Array]) -> tuple[Array, None]:
        known, interval = inputs
        half = x + (known + velocity(x) * interval[:, None]) / 2
        return x + known + velocity(half) * interval[:, None], None

    order = jnp.moveaxis(steps, 1, 0), intervals.T
    return jax.lax.scan(step, starts, order)[0]
