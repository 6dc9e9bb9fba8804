r"""Other methods for commanded robots, for comparison with `pinav identify`.

A Gaussian process for the disturbance of $v = a_0 f\,n(\theta) + D$, the published
method for these robots, and a black-box neural differential equation.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float
from scipy.linalg import cho_solve
from scipy.optimize import minimize

from pinav.forces import tanh_network
from pinav.identification import Track
from pinav.identification.baselines import velocities
from pinav.identification.forecast import Displacement, integrate_held
from pinav.identification.tracks import commands_of
from pinav.recordings.drive import command_vector
from pinav.trajectories import Trajectory


class Samples(NamedTuple):
    """Velocities of a track beside positions and commands."""

    velocity: Float[np.ndarray, "sample 2"]
    position: Float[np.ndarray, "sample 2"]
    frequency: Float[np.ndarray, " sample"]
    heading: Float[np.ndarray, " sample"]

    @classmethod
    def of(cls, track: Track) -> "Samples":
        """All samples whose window lies within their segment."""
        parts = []
        for piece in track.pieces:
            velocity, rows = velocities(track, piece)
            others = piece.states, *commands_of(piece)
            parts.append((velocity, *(values[rows] for values in others)))
        return cls(*map(np.concatenate, zip(*parts, strict=True)))

    def command(self) -> Float[np.ndarray, "sample 2"]:
        r"""$f\,n(\theta)$ [Hz]."""
        return command_vector(self.frequency, self.heading)


def gaussian_process(
    track: Track, *, rows: int | None = 400, restarts: int = 0
) -> Displacement:
    r"""$v = a_0 f\,n(\theta) + D(\theta, f)$ with a Gaussian process for each D.

    As published: $a_0$ is the median of speed over frequency, the kernel a constant
    times a squared exponential of heading and frequency plus white noise, its
    hyperparameters those of highest likelihood.

    Args:
        track: what is fitted.
        rows: samples that are kept, evenly spaced; all where None, as published.
        restarts: further starts of the search of hyperparameters; 10 as published.

    References:
        Kermanshah et al., arXiv:2406.02722; Beaver et al., arXiv:2212.00188.
    """
    samples = Samples.of(track)
    speed = np.hypot(*samples.velocity.T)
    rolling = samples.frequency > 0
    gain = float(np.median(speed[rolling] / samples.frequency[rolling]))
    disturbance = samples.velocity - gain * samples.command()
    inputs = np.stack([samples.heading, samples.frequency], axis=1)
    kept = np.arange(len(inputs))
    if rows is not None and len(kept) > rows:
        kept = np.linspace(0, len(inputs) - 1, rows).astype(int)
    means = [
        _process_mean(inputs[kept], disturbance[kept, axis], restarts)
        for axis in (0, 1)
    ]

    def velocity(piece: Trajectory) -> Float[np.ndarray, "time 2"]:
        frequency, heading = commands_of(piece)
        places = np.stack([heading, frequency], axis=1)
        learned = np.stack([mean(places) for mean in means], axis=1)
        return gain * command_vector(frequency, heading) + learned

    return lambda piece: integrate_held(velocity(piece), piece.times)


LEAST, GREATEST = math.log(1e-2), math.log(1e2)
"""Bounds of the logarithms of variance, length and noise, as published."""


def _process_mean(
    inputs: Float[np.ndarray, "row 2"], values: Float[np.ndarray, " row"], restarts: int
) -> Callable[[Float[np.ndarray, "place 2"]], Float[np.ndarray, " place"]]:
    """Mean of the Gaussian process of highest marginal likelihood.

    References:
        Rasmussen and Williams, Gaussian Processes for Machine Learning, eq. (2.30).
    """
    squares = ((inputs[:, None] - inputs[None]) ** 2).sum(axis=-1)
    random = np.random.default_rng(0)
    starts = [np.zeros(3), *random.uniform(LEAST, GREATEST, (restarts, 3))]
    ends = [
        minimize(
            _negative_log_likelihood,
            start,
            args=(squares, values),
            jac=True,
            bounds=[(LEAST, GREATEST)] * 2 + [(2 * LEAST, GREATEST)],
        )
        for start in starts
    ]
    logs = min(ends, key=lambda end: end.fun).x
    weights = np.linalg.solve(_covariance(logs, squares), values)

    def mean(places: Float[np.ndarray, "place 2"]) -> Float[np.ndarray, " place"]:
        offsets = ((places[:, None] - inputs[None]) ** 2).sum(axis=-1)
        return _kernel(logs, offsets) @ weights

    return mean


def _kernel(
    logs: Float[np.ndarray, "3"], squares: Float[np.ndarray, "m n"]
) -> Float[np.ndarray, "m n"]:
    """Squared exponential, by log variance, log length and log noise variance."""
    return np.exp(logs[0] - squares / (2 * np.exp(2 * logs[1])))


def _covariance(
    logs: Float[np.ndarray, "3"], squares: Float[np.ndarray, "n n"]
) -> Float[np.ndarray, "n n"]:
    return _kernel(logs, squares) + np.exp(logs[2]) * np.eye(len(squares))


def _negative_log_likelihood(
    logs: Float[np.ndarray, "3"],
    squares: Float[np.ndarray, "n n"],
    values: Float[np.ndarray, " n"],
) -> tuple[float, Float[np.ndarray, "3"]]:
    """Marginal likelihood and its gradient."""
    kernel = _kernel(logs, squares)
    factor = np.linalg.cholesky(kernel + np.exp(logs[2]) * np.eye(len(values)))
    inverse = cho_solve((factor, True), np.eye(len(values)))
    weights = inverse @ values
    value = 0.5 * values @ weights + np.log(np.diag(factor)).sum()
    # d value / d K = (K^-1 - w w^T) / 2, contracted with dK of each logarithm.
    outer = 0.5 * (inverse - np.outer(weights, weights))
    slopes = (kernel, kernel * squares / np.exp(2 * logs[1]))
    by_noise = np.exp(logs[2]) * np.trace(outer)
    return float(value), np.array([*(np.sum(outer * k) for k in slopes), by_noise])


NETWORK_STEPS, LEARNING_RATE = 1000, 1e-2
"""Of Adam, for the black box."""


def black_box(track: Track, *, seed: int = 0) -> Displacement:
    """A neural differential equation: a network of position and command.

    Trained by Adam on velocities over one second, which for a system observed all along
    is the multiple shooting of one-second windows from the data.

    Args:
        track: what is fitted.
        seed: of the weights.
    """
    samples = Samples.of(track)
    center = samples.position.mean(axis=0)
    scales = (
        float(samples.position.std()) or 1.0,
        float(np.abs(samples.frequency).max()) or 1.0,
        float(samples.velocity.std()) or 1.0,
    )

    def features(position: np.ndarray, command: np.ndarray) -> np.ndarray:
        scaled = (position - center) / scales[0], command / scales[1]
        return np.concatenate(scaled, axis=1)

    untrained = tanh_network(4, 2, width=32, depth=2, key=jax.random.key(seed))
    network: Any = _train(
        untrained,
        jnp.asarray(features(samples.position, samples.command())),
        jnp.asarray(samples.velocity / scales[2]),
    )

    def velocity(piece: Trajectory) -> np.ndarray:
        places = features(piece.states, command_vector(*commands_of(piece)))
        return np.asarray(jax.vmap(network)(jnp.asarray(places))) * scales[2]

    return lambda piece: integrate_held(velocity(piece), piece.times)


@eqx.filter_jit
def _train(network: Any, inputs: Array, targets: Array) -> Any:
    optimiser = optax.adam(optax.cosine_decay_schedule(LEARNING_RATE, NETWORK_STEPS))
    weights, static = eqx.partition(network, eqx.is_inexact_array)

    def loss(weights: Any) -> Array:
        predicted = jax.vmap(eqx.combine(weights, static))(inputs)
        return jnp.mean((predicted - targets) ** 2)

    def step(state: tuple, _: None) -> tuple[tuple, None]:
        weights, memory = state
        updates, memory = optimiser.update(jax.grad(loss)(weights), memory, weights)
        return (optax.apply_updates(weights, updates), memory), None

    start = weights, optimiser.init(weights)
    (weights, _), _ = jax.lax.scan(step, start, length=NETWORK_STEPS)
    return eqx.combine(weights, static)
