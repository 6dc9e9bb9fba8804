"""The average of two models is weighted by what training rollouts say."""

import numpy as np
import pytest

from pinav.identification.rollouts import PRIOR_ROLLOUTS, stack, stacking_weight
from pinav.identification.tracks import Track
from pinav.trajectories import Trajectory


def straight(duration):
    """A robot that runs along x at 1 um/s, ten frames a second."""
    times = np.arange(0.0, duration, 0.1)
    states = np.stack([times, 0 * times], axis=1)
    piece = Trajectory(times, states, np.ones_like(states, bool), {})
    return Track("straight", (piece,), 0.5, (len(times), 2 * int(duration)))


def at_speed(speed):
    return lambda piece: speed * piece.states


@pytest.mark.parametrize(("ours", "wanted"), [(1.0, 1.0), (1.5, 0.5), (0.5, 0.5)])
def test_the_weight_is_drawn_to_a_half_as_by_fifteen_rollouts(ours, wanted):
    # Beside a model at half of the speed; the third is the same one. Rollouts of 10 s
    # begin every 5 s.
    weight = stacking_weight(straight(100.1), at_speed(ours), at_speed(0.5))
    drawn = (19 * wanted + PRIOR_ROLLOUTS * 0.5) / (19 + PRIOR_ROLLOUTS)
    assert weight == pytest.approx(drawn, rel=1e-9)


def test_without_a_rollout_the_weights_are_equal():
    assert stacking_weight(straight(8.0), at_speed(1.0), at_speed(0.0)) == 0.5


def test_a_weight_is_never_negative():
    # The other model is right, and ours is on its far side.
    track = straight(2000.0)
    assert stacking_weight(track, at_speed(-5.0), at_speed(-1.0)) == 0.0


def test_an_average_lies_between_both_paths():
    (piece,) = straight(20.0).pieces
    path = stack(at_speed(1.0), at_speed(0.0), 0.25)(piece)
    np.testing.assert_allclose(path, 0.25 * piece.states)
