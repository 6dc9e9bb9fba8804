"""Figures of recordings show what they are given, with units and equal axes."""

import numpy as np

from pinav.figures.identification import horizon_errors, rollout_paths, speed_law

UNITS = {"x": "um", "y": "um", "t": "s"}


def test_rollouts_have_equal_axes_units_and_bands():
    path = np.cumsum(np.ones((20, 2)), axis=0)
    ax = rollout_paths([path], [path[:5], path[5:9]], [np.ones(2)] * 2, units=UNITS)
    assert ax.get_aspect() == 1
    assert ax.get_xlabel() == "$x$ [µm]"
    (bands,) = ax.collections
    np.testing.assert_allclose(bands.get_offsets(), [path[4], path[8]])


def test_errors_by_horizon_draw_a_line_for_each_model():
    ax = horizon_errors((1.0, 10.0), {"chosen": [0.1, 0.05], "other": [0.2, 0.3]})
    assert len(ax.lines) == 2
    assert ax.get_xlabel() == "rollout [s]"
    assert ax.get_yscale() == "log"


def test_the_speed_law_has_its_band():
    places = np.linspace(0, 5, 9)
    curve = (places, 2 * places, np.full(9, 0.5))
    ax = speed_law(places, 2 * places, curve)
    assert ax.get_ylabel() == "speed along the command [µm/s]"
    (band,) = ax.collections
    low, high = band.get_datalim(ax.transData).intervaly
    assert low < 0 < high
