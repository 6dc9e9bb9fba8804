"""Kernels in space: few enough to be fitted, and refused where they are not."""

import equinox as eqx
import numpy as np
import pytest

from pinav.errors import InputError
from pinav.fitting import KernelGrid, kernel_environment
from pinav.fitting.environments.kernels import (
    AT_FIRST,
    MOST_WEIGHTS,
    POSSIBLE,
    check_size,
    num_weights,
)
from pinav.fitting.environments.summary import ModelChoice, summarise_for
from pinav.forces import KernelForce, KernelPotential
from pinav.trajectories import Trajectories


@pytest.fixture(scope="module")
def tracks():
    """Ten tracks that cross a cube."""
    rng = np.random.default_rng(0)
    times = np.linspace(0.0, 1.0, 30)
    starts, ends = rng.uniform(0.0, 10.0, size=(2, 10, 1, 3))
    states = list(starts + (ends - starts) * times[:, None])
    return Trajectories.from_arrays(times, states, channels=("x", "y", "z"))


@pytest.mark.parametrize("kind", [KernelPotential, KernelForce])
def test_kernels_in_space_are_laid_coarsely_unless_asked(tracks, kind):
    made = kernel_environment(kind, tracks, dim=3)
    assert num_weights(made) <= AT_FIRST * MOST_WEIGHTS
    asked = kernel_environment(kind, tracks, KernelGrid(), dim=3)
    assert num_weights(asked) > AT_FIRST * MOST_WEIGHTS


def test_a_model_by_name_has_the_kernels_of_a_fit(tracks):
    made = kernel_environment(KernelPotential, tracks, dim=3)
    summary = summarise_for(ModelChoice("kernel-potential"), tracks)
    assert eqx.tree_equal(summary.environment, made)


def test_more_weights_than_can_be_fitted_are_refused_with_the_remedy():
    places = np.zeros((int(POSSIBLE * MOST_WEIGHTS) + 1, 2))
    with pytest.raises(InputError, match="at most 4000 weights, got 4001; lay fewer"):
        check_size(KernelPotential.with_zero_weights(places, 1.0))
