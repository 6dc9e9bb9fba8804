"""Rollouts that start anew miss by what is wrong, not by how long a film is."""

import numpy as np
import pytest

from pinav.dynamics import OverdampedSwimmer
from pinav.evaluation import restart_errors
from pinav.forces import UniformFlow, ZeroForce
from pinav.trajectories import Trajectories

DRIFT = np.array([0.3, -0.4])


def film(duration, lost=()):
    """A particle that drifts, and a second one that was seen for 4 s alone."""
    times = np.arange(0, duration + 0.05, 0.1)
    path = 2.0 + times[:, None] * DRIFT
    observed = np.ones((len(times), 2), bool)
    observed[list(lost)] = False
    return Trajectories.from_arrays(
        [times, times[:40]],
        [path, path[:40]],
        channels=("x", "y"),
        observed=[observed, observed[:40]],
        units={"x": "um", "y": "um", "t": "s"},
    )


def still():
    return OverdampedSwimmer(ZeroForce(), ZeroForce(), 1.0, UniformFlow((0.0, 0.0)))


@pytest.mark.parametrize("duration", [35.0, 1000.0])
def test_errors_of_a_model_without_the_drift_are_the_drift(duration):
    errors = restart_errors(still(), film(duration, lost=(0, 7, 120)))
    np.testing.assert_allclose(errors.errors, 0.5 * errors.lengths, rtol=1e-6)
    assert errors.rollouts == (3 if duration == 35.0 else 60)

    assert restart_errors(still(), film(8.0)) is None
