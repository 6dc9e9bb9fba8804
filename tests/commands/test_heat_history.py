"""What `pinav heat` follows over time, and what its figures say."""

import numpy as np
import pytest

from pinav.commands.heat.history import end_of_heating, saved_times
from pinav.commands.heat.report import _duration, _sections
from pinav.thermal.dose import time_to_reach
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


def test_times_in_legends_are_exact():
    seconds = [60.0, 90.0, 0.25, 61.0]
    assert [_duration(t) for t in seconds] == ["1 min", "90 s", "0.25 s", "61 s"]


def test_maps_go_through_the_hottest_cell_and_the_tumour():
    arrays = {
        "target": np.zeros((4, 4, 6)),
        "temperature": np.full((4, 4, 6), 37.0),
        "spacing": np.full(3, 2e-3),
    }
    arrays["target"][1:3, 1:3, 1] = 1.0
    arrays["temperature"][0, 0, 4] = 45.0
    cuts = _sections(arrays, arrays["temperature"])
    assert list(cuts) == ["z = 9 mm, hottest cell", "z = 3 mm, tumour"]
    assert [cut[2] for cut in cuts.values()] == [4, 1]
    arrays["temperature"][0, 0, 4] = 37.0
    arrays["temperature"][1, 1, 1] = 45.0
    assert list(_sections(arrays, arrays["temperature"])) == [
        "z = 3 mm, hottest cell and tumour"
    ]
