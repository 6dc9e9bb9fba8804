"""What the figures of bioheat say in words."""

import numpy as np

from pinav.figures.heat import duration, sections_through


def test_times_in_legends_are_exact():
    seconds = [60.0, 90.0, 0.25, 61.0]
    assert [duration(t) for t in seconds] == ["1 min", "90 s", "0.25 s", "61 s"]


def test_maps_go_through_the_hottest_cell_and_the_tumour():
    target, temperature = np.zeros((4, 4, 6)), np.full((4, 4, 6), 37.0)
    target[1:3, 1:3, 1] = 1.0
    temperature[0, 0, 4] = 45.0
    assert sections_through(target, temperature, (2e-3,) * 3) == {
        "z = 9 mm, hottest cell": (2, 4),
        "z = 3 mm, tumour": (2, 1),
    }
    temperature[0, 0, 4], temperature[1, 1, 1] = 37.0, 45.0
    one = sections_through(target, temperature, (2e-3,) * 3)
    assert one == {"z = 3 mm, hottest cell and tumour": (2, 1)}
