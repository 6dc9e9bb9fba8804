"""A trap with a rotation, whose entropy production is known: draws, and a fit."""

import numpy as np

from pinav.analysis import entropy_production
from pinav.dynamics import OverdampedSwimmer
from pinav.fitting import Estimate, fit_langevin
from pinav.forces import KernelForce, ZeroForce
from pinav.trajectories import Trajectories

STEP, FRAMES, EVERY = 0.02, 10_000, 5
GRID = np.stack(np.meshgrid(*[np.arange(-5.0, 5.1)] * 2), axis=-1).reshape(-1, 2)


def path(seed, turning):
    """Exact samples of dx = (-1 + turning R) x dt + sqrt(2) dW, R a quarter turn.

    The density is that of the trap, and entropy production 2 turning^2 k_B.
    """
    random = np.random.default_rng(seed)
    c, s = np.cos(turning * STEP), np.sin(turning * STEP)
    decay = np.exp(-STEP) * np.array([[c, -s], [s, c]])
    spread = np.sqrt(1 - np.exp(-2 * STEP))
    x, rows = random.normal(size=2), []
    for kick in random.normal(size=(FRAMES, 2)):
        x = decay @ x + spread * kick
        rows.append(x)
    return np.array(rows)


def judge_trap(seed, turning):
    """Entropy production of a fit by kernels, one a unit of length."""
    xs = path(seed, turning)
    data = Trajectories.from_arrays(
        STEP * np.arange(FRAMES), xs[None], channels=("x", "y")
    )
    force = KernelForce.with_zero_weights(GRID[np.linalg.norm(GRID, axis=1) < 5.2], 1.0)
    swimmer = OverdampedSwimmer(ZeroForce(), force, 1.0)
    fit = fit_langevin(swimmer, data, refine=None)
    places, diffusion = xs[::EVERY], fit.thermal.diffusion
    assert isinstance(diffusion, Estimate)
    field = np.full(places.shape, diffusion.value)
    return entropy_production(
        fit.posterior, places, field, diffusion.sd / diffusion.value
    )
