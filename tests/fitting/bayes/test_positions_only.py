"""Positions alone, of a swimmer with inertia, with JAX as it is by default."""

import jax
import numpy as np
import pytest

import pinav


def oscillations():
    """Paths in a trap of stiffness 0.49, with noise of 0.005."""
    random = np.random.default_rng(0)
    t = np.linspace(0, 3, 31)
    waves = np.stack([np.cos(0.7 * t), np.sin(0.7 * t)], axis=1)
    paths = [waves @ random.normal(size=(2, 2)) for _ in range(6)]
    noisy = [path + 0.005 * random.normal(size=path.shape) for path in paths]
    return pinav.Trajectories.from_arrays(t, noisy, channels=("x", "y"))


@pytest.mark.parametrize("x64", [True, False], ids=["float64", "float32"])
def test_a_swimmer_is_fitted_to_positions_alone(x64):
    with jax.enable_x64(x64):
        trap = pinav.HarmonicTrap(0.3, [0.0, 0.0])
        model = pinav.Swimmer(pinav.ZeroForce(), pinav.LinearDrag(0.0), trap)
        fit = pinav.fit_bayes(
            model, oscillations(), learn=lambda m: m.environment.stiffness
        )
    estimate = fit.constants["environment.stiffness"]
    assert abs(estimate.value - 0.49) < 3 * estimate.sd < 0.005
    assert fit.model.environment.stiffness.dtype == np.float64
    assert fit.states.shape == (6, 31, 4)


def test_kernels_are_laid_in_the_space_of_the_positions():
    kernels = pinav.kernel_environment(pinav.KernelForce, oscillations())
    assert kernels.centers.shape[1] == 2
