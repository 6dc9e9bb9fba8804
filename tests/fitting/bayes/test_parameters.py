"""Which numbers a fit learns."""

import jax.numpy as jnp
import numpy as np
import pytest

from pinav.dynamics import OverdampedSwimmer
from pinav.fitting.bayes.parameters import parametrise
from pinav.forces import KernelPotential, PoiseuilleFlow, ZeroForce


@pytest.fixture(scope="module")
def swimmer():
    grid = np.stack(np.meshgrid(np.arange(3.0), np.arange(2.0)), -1).reshape(-1, 2)
    kernels = KernelPotential(jnp.zeros(6), jnp.asarray(grid), 1.0)
    flow = PoiseuilleFlow(peak=0.5, middle=0.0, half_width=1.0)
    return OverdampedSwimmer(ZeroForce(), kernels, 1.0, flow=flow)


@pytest.mark.parametrize(
    "learn",
    [lambda s: s.flow.peak, lambda s: (s.environment, s.flow.peak)],
    ids=["peak", "environment and peak"],
)
def test_weights_are_learned_whether_or_not_the_environment_is_named(swimmer, learn):
    _, theta = parametrise(swimmer, learn)
    assert theta.tolist() == [0.0] * 6 + [0.5]
