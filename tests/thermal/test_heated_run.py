"""What of a run is followed over time, and in which planes."""

import numpy as np
import pytest

from pinav.thermal.dose import time_to_reach
from pinav.thermal.heated_run import cuts_through, end_of_heating, saved_times
from pinav.thermal.protocols import Piecewise


def test_every_switch_of_a_burst_is_saved_once():
    bursts = Piecewise.on_off(1e4, 1e5, on=7.0, off=13.0, duration=600.0)
    times = saved_times(bursts)
    assert np.all(np.diff(times) > 1e-3)
    assert np.isin(bursts.edges[1:], times).all()
    assert times[-1] == 600.0
    assert len(times) > 180


def test_heating_ends_where_the_field_is_last_on():
    pause = Piecewise.constant((0.0, 60.0, 90.0, 600.0), [1e4, 5e3, 0.0], 1e5)
    assert end_of_heating(pause) == 90.0
    never = Piecewise.constant((0.0, 60.0), [0.0], 1e5)
    assert end_of_heating(never) == 60.0
    ramp = Piecewise.ramp((0.0, 60.0, 90.0), [0.0, 1e4, 0.0], 1e5)
    assert end_of_heating(ramp) == 90.0
    # a plan leaves a millionth of its largest amplitude where it is off
    plan = Piecewise.constant((0.0, 60.0, 90.0), [1e4, 1e-2], 1e5)
    assert end_of_heating(plan) == 60.0


@pytest.mark.parametrize(
    ("level", "time"), [(1.0, 10.0), (3.0, 15.0), (4.0, 20.0), (4.1, None)]
)
def test_time_to_a_dose(level, time):
    reached = time_to_reach(np.array([10.0, 20.0]), np.array([2.0, 4.0]), level)
    assert reached == time


def test_planes_lie_in_the_middle_of_the_target():
    target = np.zeros((9, 8, 7))
    target[2:5, 4:7, 1:4] = 1.0
    assert cuts_through(target) == ((2, 2), (1, 5), (0, 3))
    assert cuts_through(np.ones((3, 4))) == ((2, None),)
    assert cuts_through(np.ones(4)) == ()
