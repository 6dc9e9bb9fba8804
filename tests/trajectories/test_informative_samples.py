import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pinav.trajectories import Trajectories, informative_rows, informative_samples


@given(st.integers(1, 400), st.integers(1, 100))
@example(382, 5)
def test_no_more_rows_than_asked_for_and_in_order(count, most):
    states = np.random.default_rng(count).normal(size=(count, 3))
    rows = informative_rows(states, most)
    assert len(rows) <= most
    assert np.all(np.diff(rows) > 0)
    assert 0 <= rows[0] <= rows[-1] < count


def test_half_of_the_rows_stand_where_the_states_change():
    step = np.tanh((np.arange(1000) - 500) / 10)[:, None]
    rows = informative_rows(step, 200)
    near = np.abs(rows - 500) < 30
    assert near.sum() > 0.25 * len(rows)
    assert (~near).sum() > 0.4 * len(rows)


def test_equal_states_are_chosen_evenly():
    rows = informative_rows(np.ones((100, 2)), 10)
    assert len(rows) == pytest.approx(10, abs=5)
    assert np.diff(rows).max() - np.diff(rows).min() <= 1


def test_samples_are_those_after_the_first_and_before_the_padding():
    times = [np.arange(4.0), np.arange(3.0)]
    states = [np.ones((4, 2)), np.ones((3, 2))]
    data = Trajectories.from_arrays(times, states, channels=("x", "y"))
    chosen = informative_samples(data, 100)
    assert chosen.tolist() == [[0, 1], [0, 2], [0, 3], [1, 1], [1, 2]]
