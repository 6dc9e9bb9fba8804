"""A force that pulls back: found where it is, and not where the velocity wanders."""

import numpy as np
import pytest

from pinav.errors import InputError
from pinav.identification import tracks
from pinav.identification.baselines import restoring_force
from pinav.identification.selection import split
from pinav.trajectories import Trajectories


def track_of(path, interval):
    times = interval * np.arange(len(path))
    data = Trajectories.from_arrays(
        [times], [path], channels=("x", "y"), units={"x": "um", "y": "um", "t": "s"}
    )
    return tracks(data)[0]


def trapped(rate=1.5, rows=4000, interval=0.05, centre=(3.0, -2.0)):
    """A bead in a trap, stepped exactly."""
    noise = np.random.default_rng(0).normal(size=(rows, 2))
    decay = np.exp(-rate * interval)
    scale = np.sqrt((1 - decay**2) / rate)
    path = np.zeros((rows, 2))
    for i in range(1, rows):
        path[i] = decay * path[i - 1] + scale * noise[i]
    return path + centre


def wandering(memory=3.0, rows=4000, interval=0.05):
    """A path whose velocity wanders."""
    noise = np.random.default_rng(1).normal(size=(rows, 2))
    decay = np.exp(-interval / memory)
    velocity = np.zeros((rows, 2))
    for i in range(1, rows):
        velocity[i] = decay * velocity[i - 1] + np.sqrt(1 - decay**2) * noise[i]
    return np.cumsum(velocity, axis=0) * interval


def test_a_trap_is_found_with_its_rate_and_centre():
    force = restoring_force(*split(track_of(trapped(), 0.05), 0.7))
    assert force.nats > 50
    np.testing.assert_allclose(force.rates, 1.5, rtol=0.5)
    np.testing.assert_allclose(force.centre, (3.0, -2.0), atol=0.4)
    assert force.explained > 0.35
    assert "pulls back to (" in force.sentence(5.0)
    assert "held-out displacements over 10 s" in force.sentence(5.0)


def test_a_wandering_velocity_is_not_taken_for_a_trap():
    force = restoring_force(*split(track_of(wandering(), 0.05), 0.7))
    assert force.nats < 5
    assert "not supported" in force.sentence(5.0)


def test_a_short_track_is_not_asked():
    train, held_out = split(track_of(trapped(rows=200), 0.05), 0.7)
    with pytest.raises(InputError, match="expected 30 displacements of 0.5 s or more"):
        restoring_force(train, held_out)
