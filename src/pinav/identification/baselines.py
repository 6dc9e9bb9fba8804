r"""What others do with such recordings, scored alike.

Least squares of the velocity; a Gaussian process for the disturbance of
$v = a_0 f\,n(\theta) + D$, the published method for these robots; a black-box neural
differential equation.
"""

import importlib
import threading
import time
import warnings
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Float

from pinav.errors import InputError
from pinav.forces import tanh_network
from pinav.identification.forecast import Displacement
from pinav.identification.tracks import Track
from pinav.trajectories import Trajectory

QUIET = threading.Lock()
"""Filters of warnings belong to all threads: one at a time may set them."""

WINDOW = 1.0
"""Velocities are central differences over this time [s]."""


class Baseline(eqx.Module):
    """A fitted baseline.

    Attributes:
        name: in tables.
        velocity: of a segment, at each of its samples [L T⁻¹].
        seconds: that the fit took.
    """

    name: str = eqx.field(static=True)
    velocity: Callable[[Trajectory], Float[np.ndarray, "time 2"]]
    seconds: float

    def displacement(self) -> Displacement:
        """Its velocity, held from sample to sample, integrated."""

        def path(piece: Trajectory) -> Float[np.ndarray, "time 2"]:
            steps = self.velocity(piece)[:-1] * np.diff(piece.times)[:, None]
            return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])

        return path


class Samples(eqx.Module):
    """Velocities of a track beside the commands.

    Attributes:
        velocity: central differences [L T⁻¹].
        position: [L].
        frequency: [Hz].
        heading: [rad].
    """

    velocity: Float[np.ndarray, "sample 2"]
    position: Float[np.ndarray, "sample 2"]
    frequency: Float[np.ndarray, " sample"]
    heading: Float[np.ndarray, " sample"]

    @classmethod
    def of(cls, track: Track) -> "Samples":
        """All samples whose window lies within their segment."""
        parts = []
        window = min(WINDOW, 2 * track.width)
        for piece in track.pieces:
            times = piece.times
            low = np.searchsorted(times, times - window / 2)
            high = np.searchsorted(times, times + window / 2, side="right") - 1
            inner = (times - times[0] >= window / 2) & (times[-1] - times >= window / 2)
            inner &= high > low
            low, high = low[inner], high[inner]
            interval = (times[high] - times[low])[:, None]
            velocity = (piece.states[high] - piece.states[low]) / interval
            frequency, heading = commands(piece)
            parts.append(
                (velocity, piece.states[inner], frequency[inner], heading[inner])
            )
        return cls(*map(np.concatenate, zip(*parts, strict=True)))

    def command(self) -> Float[np.ndarray, "sample 2"]:
        r"""$f\,n(\theta)$ [Hz]."""
        return _vector(self.frequency, self.heading)


def commands(piece: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Frequency and heading of a segment; zeros where nothing was commanded."""
    nothing = np.zeros_like(piece.times)
    return (
        piece.commands.get("frequency", nothing),
        piece.commands.get("heading", nothing),
    )


def _vector(frequency, heading):
    return frequency[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)


def least_squares(track: Track) -> Baseline:
    """Gain matrix and drift by least squares of the velocity: no delay, no noise."""
    begin = time.perf_counter()
    samples = Samples.of(track)

    def rows(command):
        return np.concatenate([command, np.ones((len(command), 1))], axis=1)

    design = rows(samples.command())
    best = np.linalg.lstsq(design, samples.velocity, rcond=None)[0]

    def velocity(piece):
        return rows(_vector(*commands(piece))) @ best

    return Baseline("least squares", velocity, time.perf_counter() - begin)


def gaussian_process(
    track: Track, *, rows: int | None = 400, restarts: int = 0
) -> Baseline:
    r"""$v = a_0 f\,n(\theta) + D(\theta, f)$ with a Gaussian process for each D.

    As published: $a_0$ is the median of speed over frequency, the kernel a constant
    times a squared exponential of heading and frequency plus white noise, its
    hyperparameters those of highest likelihood.

    Args:
        track: what is fitted.
        rows: samples that are kept, evenly spaced; all where None, as published.
        restarts: of the search of hyperparameters; 10 as published.

    Raises:
        InputError: scikit-learn is not installed.

    References:
        Sokolich et al., arXiv:2406.02722; Beaver et al., arXiv:2212.00188.
    """
    try:
        processes_of: Any = importlib.import_module("sklearn.gaussian_process")
    except ImportError as error:
        raise InputError(
            "gaussian_process: scikit-learn is not installed; install pinav[bench]"
        ) from error
    begin = time.perf_counter()
    samples = Samples.of(track)
    speed = np.hypot(*samples.velocity.T)
    rolling = samples.frequency > 0
    gain = float(np.median(speed[rolling] / samples.frequency[rolling]))
    disturbance = samples.velocity - gain * samples.command()
    inputs = np.stack([samples.heading, samples.frequency], axis=1)
    kept = np.arange(len(inputs))
    if rows is not None and len(kept) > rows:
        kept = np.linspace(0, len(inputs) - 1, rows).astype(int)
    processes = []
    for axis in (0, 1):
        kinds = processes_of.kernels
        kernel = kinds.ConstantKernel(1.0, (1e-2, 1e2)) * kinds.RBF(1.0, (1e-2, 1e2))
        kernel = kernel + kinds.WhiteKernel()
        process = processes_of.GaussianProcessRegressor(
            kernel=kernel, n_restarts_optimizer=restarts, random_state=0
        )
        with QUIET, warnings.catch_warnings():  # of a number at its published bound
            warnings.simplefilter("ignore")
            processes.append(process.fit(inputs[kept], disturbance[kept, axis]))

    def velocity(piece):
        frequency, heading = commands(piece)
        places = np.stack([heading, frequency], axis=1)
        learned = np.stack([p.predict(places) for p in processes], axis=1)
        return gain * _vector(frequency, heading) + learned

    seconds = time.perf_counter() - begin
    return Baseline("Gaussian-process disturbance", velocity, seconds)


def stochastic_force_inference(track: Track) -> Baseline:
    """Always refused, with the reason: the method has no place for commands.

    Raises:
        InputError: always.
    """
    del track
    raise InputError(
        "it infers forces that depend on the position and has no command inputs"
    )


NETWORK_STEPS, LEARNING_RATE = 1000, 1e-2
"""Of Adam, for the black box."""


def black_box(track: Track, *, seed: int = 0) -> Baseline:
    """A neural differential equation: a network of position and command.

    Trained by Adam on velocities over one second, which for a system observed all along
    is the multiple shooting of one-second windows from the data.

    Args:
        track: what is fitted.
        seed: of the weights.
    """
    begin = time.perf_counter()
    samples = Samples.of(track)
    center = samples.position.mean(axis=0)
    scales = (
        float(samples.position.std()) or 1.0,
        float(np.abs(samples.frequency).max()) or 1.0,
        float(samples.velocity.std()) or 1.0,
    )

    def features(position, command):
        scaled = (position - center) / scales[0], command / scales[1]
        return np.concatenate(scaled, axis=1)

    untrained = tanh_network(4, 2, width=32, depth=2, key=jax.random.key(seed))
    network: Any = _trained(
        untrained,
        jnp.asarray(features(samples.position, samples.command())),
        jnp.asarray(samples.velocity / scales[2]),
    )

    def velocity(piece):
        places = features(piece.states, _vector(*commands(piece)))
        return np.asarray(jax.vmap(network)(jnp.asarray(places))) * scales[2]

    return Baseline("neural ODE", velocity, time.perf_counter() - begin)


@eqx.filter_jit
def _trained(network, inputs, targets):
    optimiser = optax.adam(optax.cosine_decay_schedule(LEARNING_RATE, NETWORK_STEPS))
    weights, static = eqx.partition(network, eqx.is_inexact_array)

    def loss(weights):
        predicted = jax.vmap(eqx.combine(weights, static))(inputs)
        return jnp.mean((predicted - targets) ** 2)

    def step(state, _):
        weights, memory = state
        updates, memory = optimiser.update(jax.grad(loss)(weights), memory, weights)
        return (optax.apply_updates(weights, updates), memory), None

    start = weights, optimiser.init(weights)
    (weights, _), _ = jax.lax.scan(step, start, length=NETWORK_STEPS)
    return eqx.combine(weights, static)
