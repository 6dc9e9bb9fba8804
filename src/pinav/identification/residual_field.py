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

from pinav.fitting import LinearFit, model_evidence, ravel_model
from pinav.fitting.evidence.quadratic import Quadratic
from pinav.fitting.evidence.weights import GaussianWeights
from pinav.identification.fit import TrackFit
from pinav.identification.forecast import Errors, Rollouts, path_of
from pinav.identification.likelihood import (
    Design,
    block_means,
    compiled_whitened,
    filtered_columns,
)
from pinav.identification.tracks import Blocks, Track
from pinav.trajectories import Trajectories

NETWORK_STEPS = 5
"""Gauss-Newton steps of a network; kernels need one."""


class ResidualFit(eqx.Module):
    """A candidate with a position-dependent residual.

    Attributes:
        base: the candidate without it.
        environment: the residual velocity field, a force under mobility 1.
        base_coefficients: gain and drift given the residual.
        amplitude: of the prior that the evidence chose.
        log_evidence: of both together.
    """

    base: TrackFit
    environment: Any
    base_coefficients: Float[np.ndarray, " coefficient"]
    amplitude: float
    log_evidence: float

    @property
    def corrected(self) -> TrackFit:
        """The candidate with gain and drift as they are beside the residual."""
        return eqx.tree_at(lambda f: f.coefficients, self.base, self.base_coefficients)


def positions_of(track: Track) -> Trajectories:
    """The positions of a track as trajectories, for laying kernels."""
    return Trajectories.from_arrays(
        [piece.times for piece in track.pieces],
        [piece.states for piece in track.pieces],
        channels=("x", "y"),
    )


def fit_residual(track: Track, base: TrackFit, environment: Any) -> ResidualFit:
    """Fit the weights of an environment to what a candidate leaves.

    Args:
        track: what is fitted.
        base: a candidate of the same track.
        environment: from `kernel_environment` or `neural_environment`, untrained.
    """
    with jax.enable_x64(new_val=True):
        problem = _Problem(track, base, environment)
        weights = GaussianWeights(environment.prior())
        point, shape = problem.start, weights.start
        steps = NETWORK_STEPS if not environment.is_linear else 1
        for _ in range(steps):
            quadratic = problem.quadratic(point)
            found = weights.infer(quadratic, shape, 1.0)
            shape = found.hyperparameters.shape
            point = problem.shortened(point, found.mean, found.hyperparameters)
        linear = LinearFit(quadratic, weights, 1.0, quadratic.num_free, 0.0)
        gain = model_evidence(linear, found.hyperparameters).log_evidence
        without = problem.squares_without()
        nothing = -0.5 * (quadratic.num_free * np.log(2 * np.pi) + without)
        return ResidualFit(
            base=base,
            environment=problem.free(jnp.asarray(point)),
            base_coefficients=problem.coefficients(point),
            amplitude=found.hyperparameters.amplitude,
            log_evidence=base.log_evidence + float(gain - nothing),
        )


class _Problem:
    """Whitened residuals as a function of the environment's weights."""

    def __init__(self, track: Track, base: TrackFit, environment):
        self.base = base
        self.free, start = ravel_model(environment, lambda e: e.parameters)
        self.start = np.asarray(start)
        self.blocks = jax.tree.map(jnp.asarray, Blocks.of(track))
        whitened = compiled_whitened(
            jnp.asarray(base.theta), Design.of(base.candidate, Blocks.of(track))
        )
        rows = np.asarray(whitened.rows)
        self.present = np.any(rows != 0, axis=0)
        self.rows = rows[:, self.present]
        self.basis = np.linalg.qr(self.rows)[0]
        self.target = np.asarray(whitened.target)
        self.count = 2 * int(whitened.count) - int(self.present.sum())

    def _projected(self, values):
        return values - self.basis @ (self.basis.T @ values)

    def _values(self, point):
        """Whitened displacement by the environment."""
        theta = jnp.asarray(self.base.theta)
        return np.asarray(_moved(self.free, jnp.asarray(point), self.blocks, theta))

    def _columns(self, point):
        """Whitened displacement by the environment, and its derivative."""
        value, slope = _displacement(
            self.free, jnp.asarray(point), self.blocks, jnp.asarray(self.base.theta)
        )
        return np.asarray(value), np.asarray(slope)

    def quadratic(self, point) -> Quadratic:
        """The sum of squares about a point, gain and drift projected out."""
        value, slope = self._columns(point)
        residuals = self._projected(value - self.target)
        slope = self._projected(slope)
        return Quadratic(
            point=np.asarray(point),
            hessian=slope.T @ slope,
            gradient=slope.T @ residuals,
            squares=float(residuals @ residuals),
            num_free=self.count,
            log_determinant=0.0,
        )

    def squares_without(self) -> float:
        """The sum of squares without an environment."""
        residuals = self._projected(self.target)
        return float(residuals @ residuals)

    def shortened(self, point, mean, chosen):
        """The step to `mean`, halved until the penalised squares are no larger."""
        if self.free(jnp.asarray(point)).is_linear:
            return mean
        precision = 1 / max(chosen.amplitude, 1e-12) ** 2

        def cost(place):
            residuals = self._projected(self._values(place) - self.target)
            return residuals @ residuals + precision * place @ place

        here, length = cost(point), 1.0
        while length > 1e-3 and not cost(point + length * (mean - point)) <= here:
            length /= 2
        return point + length * (mean - point) if length > 1e-3 else point

    def coefficients(self, point) -> Float[np.ndarray, " coefficient"]:
        """Gain and drift given the environment."""
        left = self.target - self._values(point)
        found = np.zeros(len(self.present))
        found[self.present] = np.linalg.lstsq(self.rows, left, rcond=None)[0]
        return found


@eqx.filter_jit
def _moved(free, point, blocks: Blocks, theta):
    """Integral of the environment's velocity along the path, filtered."""
    moved = _block_displacement(free, point, blocks)
    return _filtered_rows(theta, moved[..., None], blocks)[:, 0]


@eqx.filter_jit
def _displacement(free, point, blocks: Blocks, theta):
    """The same, and its derivative by the weights."""
    values = _block_displacement(free, point, blocks)
    slopes = jax.jacfwd(lambda p: _block_displacement(free, p, blocks))(point)
    columns = jnp.concatenate([values[..., None], slopes], axis=-1)
    rows = _filtered_rows(theta, columns, blocks)
    return rows[:, 0], rows[:, 1:]


def _block_displacement(free, point, blocks: Blocks) -> Float[Array, "block 2"]:
    environment = free(point)
    velocity = jax.vmap(lambda x: environment(0.0, x, jnp.zeros_like(x)))
    rates = velocity(blocks.positions)
    middle = (rates[1:] + rates[:-1]) / 2
    steps = middle * jnp.diff(blocks.times)[:, None]  # leaps between segments: reset
    path = jnp.concatenate([jnp.zeros((1, 2)), jnp.cumsum(steps, axis=0)])
    return block_means(path, blocks)


def _filtered_rows(theta, columns, blocks) -> Float[Array, "row column"]:
    rest = block_means(jnp.stack([blocks.times, blocks.frequency], axis=-1), blocks)
    whitened = [_filtered_axis(theta, columns[:, a], rest, blocks) for a in (0, 1)]
    return jnp.concatenate(whitened)


def _filtered_axis(theta, columns, rest, blocks) -> Float[Array, "step column"]:
    """The columns of one axis through the filter, which wants the time as the fifth."""
    padded = jnp.concatenate(
        [jnp.zeros((columns.shape[0], 4)), rest[:, :1], columns], axis=-1
    )
    return filtered_columns(theta, padded, rest[:, 1], blocks).columns[:, 5:]


def residual_errors(track: Track, rollouts: Rollouts, fit: ResidualFit) -> Errors:
    """End-point errors of rollouts in which the residual acts along the way."""
    displacement = path_of(fit.corrected)
    paths = [displacement(piece) for piece in track.pieces]
    distance, length = [], []
    for index in range(len(track.pieces)):
        own = np.flatnonzero(rollouts.piece == index)
        if not len(own):
            continue
        piece = track.pieces[index]
        first, last = rollouts.first[own], rollouts.last[own]
        ends = _rolled_out(fit.environment, piece, paths[index], (first, last))
        distance.append(np.hypot(*(ends - piece.states[last]).T))
        steps = np.hypot(*np.diff(piece.states, axis=0).T)
        total = np.concatenate([[0.0], np.cumsum(steps)])
        length.append(total[last] - total[first])
    return Errors(
        np.concatenate(distance) if distance else np.zeros(0),
        np.concatenate(length) if length else np.zeros(0),
    )


def _rolled_out(environment, piece, path, ends):
    """Ends of rollouts by the midpoint rule, from frame to frame."""
    first, last = ends
    count = int((last - first).max())
    index = np.minimum(first[:, None] + np.arange(count + 1), last[:, None])
    steps = np.diff(path[index], axis=1)
    intervals = np.diff(piece.times[index], axis=1)
    starts = piece.states[first]
    return np.asarray(
        _integrated(environment, *map(jnp.asarray, (starts, steps, intervals)))
    )


@eqx.filter_jit
def _integrated(environment, starts, steps, intervals):
    velocity = jax.vmap(lambda x: environment(0.0, x, jnp.zeros_like(x)))

    def step(x, inputs):
        known, interval = inputs
        half = x + (known + velocity(x) * interval[:, None]) / 2
        return x + known + velocity(half) * interval[:, None], None

    order = jnp.moveaxis(steps, 1, 0), intervals.T
    return jax.lax.scan(step, starts, order)[0]
