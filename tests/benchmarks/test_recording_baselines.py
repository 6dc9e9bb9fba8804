"""Baselines of commanded robots: each predicts one that was recorded."""

import jax
import numpy as np
import pytest
from tests.identification.conftest import as_recording, robot

from benchmarks import recording_baselines
from pinav.identification import Rollouts, errors, split, tracks

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def recording():
    return as_recording(robot())


def test_the_black_box_learns_the_command(recording):
    train, held_out = split(tracks(recording)[0], 0.7)
    rollouts = Rollouts.of(held_out, 5.0)
    with jax.numpy_dtype_promotion("standard"):  # optax
        found = recording_baselines.black_box(train)
    own = errors(held_out, rollouts, found).relative
    nothing = errors(held_out, rollouts, lambda piece: 0 * piece.states).relative
    assert own < 0.7 * nothing


def test_the_gaussian_process_learns_the_disturbance(recording):
    track = tracks(recording)[0]
    found = recording_baselines.gaussian_process(track, rows=60)
    rollouts = Rollouts.of(track, 5.0)
    assert errors(track, rollouts, found).relative < 0.3


def test_the_gradient_of_the_marginal_likelihood_is_that_of_differences():
    random = np.random.default_rng(0)
    inputs, values = random.normal(size=(12, 2)), random.normal(size=12)
    squares = ((inputs[:, None] - inputs[None]) ** 2).sum(axis=-1)
    logs = np.array([0.3, -0.2, -1.0])
    _, slope = recording_baselines._negative_log_likelihood(logs, squares, values)
    for index, step in enumerate(1e-6 * np.eye(3)):
        high, low = (
            recording_baselines._negative_log_likelihood(
                logs + sign * step, squares, values
            )[0]
            for sign in (1, -1)
        )
        assert slope[index] == pytest.approx((high - low) / 2e-6, rel=1e-5)
