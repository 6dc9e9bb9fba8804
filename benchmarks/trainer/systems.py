"""Sixty systems by key: what a trainer that was built on one system must also learn.

Each is drawn by its key alone: the form, height and width of the potential, one to four
trajectories of 20 to 50 time units, drag, thrust and starts. Even keys are for
development, and so by now are the odd ones below 60, on which earlier recipes were
judged; odd ones from 61 on are for judging. Not one of the even keys below 60 drew a
rational hill.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.dynamics import Swimmer, rollout
from pinav.forces import (
    AbstractForce,
    ConstantForce,
    GaussianBarrier,
    LinearDrag,
    SumForce,
    gaussian_ridge,
    power_hill,
)
from pinav.systems import Observation, RingStarts, System

DEVELOPMENT = tuple(range(0, 60, 2))
"""Keys on which a recipe may be tried and changed."""

JUDGED = tuple(range(61, 121, 2))
"""Keys on which a finished recipe is measured."""

ENCOUNTERS = ("pass", "graze", "turn", "stop", "trap")
"""What the first trajectory of a system does, in turns over the keys."""

FORMS = ("gaussian", "gaussian", "ridge", "rational", "pair")
"""Forms of the potential, drawn with equal chances."""

CENTER = np.array([5.0, 5.0])


@dataclasses.dataclass(frozen=True)
class BenchmarkSystem:
    """A system of the benchmark, and what it is.

    Attributes:
        key: from which it was drawn.
        encounter: what its first trajectory does.
        form: of the potential.
        width: of the potential [L].
        system: the system itself, without noise.
    """

    key: int
    encounter: str
    form: str
    width: float
    system: System


def benchmark_system(key: int) -> BenchmarkSystem:
    """Draw a system from its key."""
    rng = np.random.default_rng([14, key])
    encounter = ENCOUNTERS[(key // 2) % len(ENCOUNTERS)]
    form = str(rng.choice(FORMS))
    width = float(np.exp(rng.uniform(np.log(0.5), np.log(5.0))))
    speed = float(rng.uniform(1.0, 5.0))
    height = 0.5 * speed**2 * (-1.0 if encounter == "trap" else 1.0)
    damping = float(np.exp(rng.uniform(np.log(0.1), np.log(0.5))))
    if encounter == "trap" and rng.random() < 0.5:
        damping *= 0.1  # an orbit that goes on is irregular in all but one form
    truth = Swimmer(
        propulsion=ConstantForce([0.0, float(rng.uniform(0.0, 0.1))]),
        drag=LinearDrag(damping=damping),
        environment=_environment(form, height, width, rng),
    )
    times = jnp.arange(0.0, rng.uniform(20.0, 50.0), 0.1)
    starts = [
        _start(truth, encounter if first else "pass", speed, width, times, rng)
        for first in [True] + [False] * int(rng.integers(0, 4))
    ]
    system = System(
        name=f"trainer-{key}",
        swimmer=truth.without_environment(),
        dim=2,
        environment=truth.environment,
        observation=Observation(noise=0.0),
        starts=jnp.asarray(starts),
        rule=RingStarts(center=(5.0, 5.0), radius=7.0, spread=2.0, speeds=(1.0, 5.0)),
        times=times,
    )
    return BenchmarkSystem(key, encounter, form, width, system)


def _environment(
    form: str, height: float, width: float, rng: np.random.Generator
) -> AbstractForce:
    if form == "rational":
        return power_hill(height, CENTER, np.sqrt(2.0) * width, 2.0)
    if form == "ridge":
        length, angle = width * rng.uniform(1.5, 3.0), rng.uniform(0.0, np.pi)
        return gaussian_ridge(height, CENTER, length, width, angle)
    barrier = GaussianBarrier(height, CENTER, width)
    if form == "gaussian":
        return barrier
    angle = rng.uniform(0.0, 2 * np.pi)
    beside = CENTER + 2.5 * width * np.array([np.cos(angle), np.sin(angle)])
    fraction = rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 1.0)
    return SumForce((barrier, GaussianBarrier(fraction * height, beside, width)))


def _start(
    truth: Swimmer,
    encounter: str,
    speed: float,
    width: float,
    times: Float[Array, " time"],
    rng: np.random.Generator,
) -> Float[np.ndarray, "4"]:
    """A start in front of the potential, aimed as the encounter asks for."""
    angle, distance = rng.uniform(0.0, 2 * np.pi), 2.0 * width + rng.uniform(1.0, 3.0)
    inwards = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-inwards[1], inwards[0]])
    offset = {"graze": rng.uniform(1.0, 1.8), "trap": rng.uniform(0.3, 1.0)}
    position = CENTER - distance * inwards
    position = position + offset.get(encounter, rng.uniform(0.0, 0.3)) * width * across
    lost = float(truth.drag.damping) * distance  # pyright: ignore
    factors = {"pass": (1.1, 1.8), "graze": (0.6, 1.2), "turn": (0.5, 0.9)}
    factor = rng.uniform(*factors.get(encounter, (0.2, 0.6)))
    if encounter != "stop":
        return np.concatenate([position, (factor * speed + lost) * inwards])
    return _stalling(truth, position, inwards, speed + lost, times)


def _stalling(
    truth: Swimmer,
    position: Float[np.ndarray, "2"],
    inwards: Float[np.ndarray, "2"],
    speed: float,
    times: Float[Array, " time"],
) -> Float[np.ndarray, "4"]:
    """The start between turning and passing: bisected until the swimmer stalls."""
    low, high = 0.0, 3.0 * speed
    for _ in range(14):
        middle = 0.5 * (low + high)
        start = np.concatenate([position, middle * inwards])
        path = np.asarray(rollout(truth, jnp.asarray(start), times).ys)[:, :2]
        passes = np.any((path - CENTER) @ inwards > 0.0)
        low, high = (low, middle) if passes else (middle, high)
    return np.concatenate([position, high * inwards])
