"""Rows and tracks that are not what they seem."""

import dataclasses

import numpy as np
import pytest

from pinav.fitting.checks.residuals import copied_tracks, weigh_outlier
from pinav.trajectories import Trajectories

RNG = np.random.default_rng(3)
TIMES = np.tile(np.linspace(0.0, 5.0, 51), (3, 1))
PATHS = np.stack([np.cumsum(RNG.normal(size=(51, 2)), axis=0) for _ in range(3)])
DATA = Trajectories.from_arrays(
    list(TIMES), list(PATHS + 0.1 * RNG.normal(size=PATHS.shape)), channels=("x", "y")
)


def test_normal_residuals_have_no_outlier():
    assert weigh_outlier(PATHS, DATA).gain < 3.0


def test_an_outlier_is_named_by_its_row_and_size():
    states = np.array(DATA.states)
    states[1, 20, 0] = PATHS[1, 20, 0] + 5.0
    told = weigh_outlier(PATHS, dataclasses.replace(DATA, states=states))
    assert told.gain > 100.0
    assert "x of trajectory 1 in row 20 lies" in told.clause
    size = float(told.clause.split("lies ")[1].split(" ")[0])
    assert size == pytest.approx(50.0, rel=0.15)


def test_what_was_not_observed_is_no_outlier():
    states = np.array(DATA.states)
    states[1, 20] = np.nan
    missing = Trajectories.from_arrays(
        list(TIMES),
        list(states),
        channels=("x", "y"),
        observed=list(np.isfinite(states)),
    )
    assert "row 20 " not in weigh_outlier(PATHS, missing).clause


def test_a_copied_track_is_found_also_with_other_rounding():
    states = np.array(DATA.states)
    states[2] = states[0] + 1e-6
    assert copied_tracks(dataclasses.replace(DATA, states=states), 0.1) == (0, 2)


def test_two_films_of_one_path_are_no_copies():
    states = np.array(DATA.states)
    states[2] = PATHS[0] + 0.1 * RNG.normal(size=PATHS[0].shape)
    states[0] = PATHS[0] + 0.1 * RNG.normal(size=PATHS[0].shape)
    assert copied_tracks(dataclasses.replace(DATA, states=states), 0.1) is None
