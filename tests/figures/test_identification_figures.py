"""Figures of recordings show what they are given, with units and equal axes."""

import numpy as np

from pinav.figures import identification
from pinav.identification import ErrorGrowth, Paths
from pinav.identification.rollouts import ShownRollout

UNITS = {"x": "um", "y": "um", "t": "s"}


def test_rollouts_have_equal_axes_units_and_bands():
    path = np.cumsum(np.ones((20, 2)), axis=0)
    seen = [path[4] + 0.5, path[8] - 0.5]
    parts = zip(seen, (path[:5], path[5:9]), strict=True)
    rollouts = [
        ShownRollout(0.0, np.vstack([one[:-1], end]), one, np.ones(2))
        for end, one in parts
    ]
    ax = identification.rollout_paths(Paths((path,), tuple(rollouts)), units=UNITS)
    assert ax.get_aspect() == 1
    assert ax.get_xlabel() == "$x$ [µm]"
    (bands,) = ax.collections
    np.testing.assert_allclose(bands.get_offsets(), [path[4], path[8]])
    (ends,) = (line for line in ax.lines if line.get_label() == "observed end")
    np.testing.assert_allclose(ends.get_xydata(), seen)


def test_rollouts_one_by_one_share_a_scale_that_holds_them_all():
    path = np.cumsum(np.ones((5, 2)), axis=0)
    sd = np.full(2, 3.0)
    rollouts = [ShownRollout(float(i), path, 1.5 * path, sd) for i in range(5)]
    titles = [f"from {i} s" for i in range(5)]
    panels = identification.single_rollouts(rollouts, units=UNITS).axes[:5]
    assert [ax.get_title(loc="left") for ax in panels] == titles
    assert len({ax.get_xlim() for ax in panels}) == 1
    low, high = panels[0].get_xlim()
    assert low < -0.5
    assert high > 1.5 * 5 - 1 + 1.6 * 3.0
    labels = [ax.get_xlabel() for ax in panels]
    assert labels == ["", "", *["$x$ [µm]"] * 3]  # none of them has a panel below
    for ax in panels:
        end = next(line for line in ax.lines if line.get_label() == "observed end")
        np.testing.assert_allclose(end.get_xydata(), [path[-1] - path[0]])


def test_the_growth_of_errors_has_its_band_and_least_squares():
    lengths = np.array([1.0, 5.0, 10.0])
    errors = np.array([[0.1, 0.2, 0.3], [0.2, 0.4, 0.6], [0.4, 0.8, 1.2]])
    counts = np.array([9, 5, 3])
    growth = ErrorGrowth(lengths, errors, 2 * errors[1], errors[2], counts)
    ax = identification.error_growth(growth, units=UNITS)
    drawn = {line.get_label(): line for line in ax.lines}
    np.testing.assert_allclose(drawn["least squares"].get_ydata(), 2 * errors[1])
    np.testing.assert_allclose(drawn["band of the model, 90 %"].get_ydata(), errors[2])
    assert ax.get_ylabel() == "end-point error [µm]"
    (band,) = ax.collections
    low, high = band.get_datalim(ax.transData).intervaly
    np.testing.assert_allclose((low, high), (0.1, 1.2))


def test_the_error_of_each_model_is_drawn():
    ax = identification.horizon_errors(
        (1.0, 10.0), {"chosen": [0.1, 0.05], "other": [0.2, 0.3]}
    )
    assert len(ax.lines) == 2
    assert ax.get_xlabel() == "rollout [s]"
    assert ax.get_yscale() == "log"
