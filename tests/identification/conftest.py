"""Synthetic recordings of a rolling robot."""

import numpy as np
import pytest

from pinav.trajectories import Trajectories

GAIN, DRIFT, DELAY, CORNER = 5.0, (0.6, -0.3), 0.25, 2.0


def robot(seed=0, *, duration=90.0, step=0.1, noise=0.05, wandering=0.3):
    """Times, positions and commands of one robot that follows random headings.

    Velocity 5 s(f(t - 0.25)) n(theta(t - 0.25)) + (0.6, -0.3) um/s with
    s = f / sqrt(1 + (f / 2)^2), an Ornstein-Uhlenbeck velocity of memory 1 s and white
    noise of the positions. Integrated by Euler's scheme on a ten times finer grid.
    """
    random = np.random.default_rng(seed)
    fine = np.arange(0, duration, step / 10)
    times = fine[::10]
    heading = np.cumsum(random.normal(0, 0.12, len(times)))
    frequency = 2 + 1.5 * np.sin(times / 4 + random.uniform(0, 6))
    index = np.searchsorted(times, fine - DELAY, side="right") - 1
    f, theta = (a[np.maximum(index, 0)] for a in (frequency, heading))
    speed = GAIN * f / np.sqrt(1 + (f / CORNER) ** 2)
    velocity = speed[:, None] * np.stack([np.cos(theta), np.sin(theta)], axis=1)
    velocity = velocity + np.array(DRIFT)
    velocity = velocity + wandering * wander(random.normal(size=(len(fine), 2)), fine)
    steps = velocity[:-1] * np.diff(fine)[:, None]
    path = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])[::10]
    seen = path + noise * random.normal(size=path.shape)
    return times, seen, {"frequency": frequency, "heading": heading}


def wander(kicks, times, memory=1.0):
    """An Ornstein-Uhlenbeck process of the variance of its kicks, one at each time."""
    decay = np.exp(-(times[1] - times[0]) / memory)
    values = [kicks[0]]
    for kick in kicks[1:]:
        values.append(decay * values[-1] + np.sqrt(1 - decay**2) * kick)
    return np.array(values)


def as_recording(*robots, commanded=True):
    """Trajectories of robots, each a run of its own."""
    times, states, commands = zip(*robots, strict=True)
    names = ("frequency", "heading") if commanded else ()
    labels = [
        {"run": f"run {i}", "particle": 1, "segment": 0} for i in range(len(times))
    ]
    return Trajectories.from_arrays(
        list(times),
        list(states),
        channels=("x", "y"),
        commands={name: [c[name] for c in commands] for name in names},
        units={"x": "um", "y": "um", "t": "s"},
        provenance={"trajectories": labels},
    )


class Synthetic:
    """The generators and their truth, for tests that need more than one robot."""

    robot, as_recording = staticmethod(robot), staticmethod(as_recording)
    gain, drift, delay, corner = GAIN, DRIFT, DELAY, CORNER


@pytest.fixture(scope="session")
def synthetic():
    return Synthetic


@pytest.fixture(scope="session")
def recording():
    return as_recording(robot())
