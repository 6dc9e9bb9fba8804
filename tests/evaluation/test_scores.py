import numpy as np
import pytest

from pinav.dynamics import Outcome
from pinav.evaluation import score
from pinav.trajectories import Trajectories


def half_observed():
    """Positions on a line, velocities never observed, one position missing."""
    states = np.zeros((4, 4))
    states[:, 0] = np.arange(4.0)
    observed = np.zeros((4, 4), bool)
    observed[:, :2] = True
    observed[2, 0] = False
    return Trajectories.from_arrays(
        np.arange(4.0), states, channels=("x", "y", "vx", "vy"), observed=observed
    )


def test_only_what_was_observed_is_scored_and_divergence_is_infinite():
    data = half_observed()
    predictions = data.states + np.array([0.3, 0.4, 9.0, 9.0])
    result = score(predictions, (Outcome.SUCCESS,), data)
    np.testing.assert_allclose(result.rmse, [0.3, 0.4, np.nan, np.nan], rtol=1e-12)
    assert result.total == pytest.approx(np.sqrt((0.3**2 + 0.4**2) / 2))
    assert result.position == result.total
    predictions = np.where(np.arange(4)[:, None] < 2, data.states, np.nan)
    result = score(predictions, (Outcome.DIVERGED,), data)
    assert result.rmse[0] == np.inf
    assert result.total == np.inf
