"""A force that pulls back: found where it is, and not where the velocity wanders."""

import numpy as np
import pytest
from tests.identification.conftest import as_recording, wander

from pinav.errors import InputError
from pinav.identification import tracks
from pinav.identification.baselines import restoring_force
from pinav.identification.selection import split


def track_of(path):
    """A path as a track, 20 positions a second."""
    return tracks(as_recording((TIMES[: len(path)], path, {}), commanded=False))[0]


TIMES = 0.05 * np.arange(4000)


def process(seed, memory):
    """A process of variance 1 along both axes."""
    kicks = np.random.default_rng(seed).normal(size=(len(TIMES), 2))
    return wander(kicks, TIMES, memory)


TRAPPED = process(0, 1 / 1.5) / np.sqrt(1.5) + (3.0, -2.0)
"""A bead in a trap."""


def test_a_trap_is_found_with_its_rate_and_centre():
    force = restoring_force(*split(track_of(TRAPPED), 0.7))
    assert force.nats > 50
    np.testing.assert_allclose(force.rates, 1.5, rtol=0.5)
    np.testing.assert_allclose(force.centre, (3.0, -2.0), atol=0.4)
    assert force.explained > 0.35
    assert "pulls back to (" in force.sentence(5.0)
    assert "held-out displacements over 10 s" in force.sentence(5.0)


def test_a_wandering_velocity_is_not_taken_for_a_trap():
    path = 0.05 * np.cumsum(process(1, 3.0), axis=0)
    force = restoring_force(*split(track_of(path), 0.7))
    assert force.nats < 5
    assert "not supported" in force.sentence(5.0)


def test_a_short_track_is_not_asked():
    train, held_out = split(track_of(TRAPPED[:200]), 0.7)
    with pytest.raises(InputError, match="expected 30 displacements of 0.5 s or more"):
        restoring_force(train, held_out)
