"""StochasticForceInference on positions alone, at the strongest setting we found.

Gradient of a radial basis, drag and thrust beside it; the noise is given to it
(`Lambda`), and PASTIS selects the functions. Width and spacing of the basis were
chosen with the truth in view, in its favour.
"""

import importlib
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.fit.contestants import Effort
from benchmarks.fit.problem import Problem, Trained

SFI: Any = importlib.import_module("SFI")
statefunc: Any = importlib.import_module("SFI.statefunc")

SPACING, WIDTH = 2.0, 2.5
"""Of the radial basis [L]."""

PROCESS_NOISE = 1e-6
"""Diffusion [L² T⁻³] that the method must assume; the trajectories have none."""


def train(problem: Problem, seed: int, effort: Effort) -> Trained:
    """The parametric estimator, then sparse selection."""
    jax.config.update("jax_enable_x64", val=True)
    positions = problem.states[..., :2]
    centers = grid(positions.reshape(-1, 2))
    tracks = SFI.TrajectoryCollection.from_arrays(
        X=np.swapaxes(positions, 0, 1), t=problem.times
    )
    inference = SFI.UnderdampedLangevinInference(tracks)
    inference.infer_force(
        _basis(jnp.asarray(centers), problem.thrust),
        eiv=False,
        Lambda=problem.noise**2 * jnp.eye(2),
        D=PROCESS_NOISE * jnp.eye(2),
    )
    inference.sparsify_force(criterion="PASTIS")
    chosen = np.asarray(inference.force_support)
    weights = np.zeros(len(centers) + 2)
    weights[chosen] = np.asarray(inference.force_coefficients)
    arrays = {
        "weights": weights[:-2],
        "centers": centers,
        "width": np.asarray(WIDTH),
        "damping": weights[-2],
        "thrust": weights[-1],
    }
    return Trained(arrays, 1, note=f"{len(chosen)} of {len(weights)} functions kept")


def grid(positions: np.ndarray) -> np.ndarray:
    """Points of a square grid within one spacing of the data."""
    low, high = positions.min(axis=0) - SPACING, positions.max(axis=0) + SPACING
    axes = [np.arange(a, b + SPACING, SPACING) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    distance = np.linalg.norm(points[:, None] - positions[None], axis=-1).min(axis=1)
    return points[distance < SPACING]


def _basis(centers, thrust):
    direction = jnp.asarray(thrust / np.linalg.norm(thrust))

    def radial(x):
        offsets = (x[None] - centers) / WIDTH
        bumps = jnp.exp(-0.5 * jnp.sum(offsets**2, axis=1))
        return (bumps[:, None] * offsets / WIDTH).T

    count = centers.shape[0]
    make = statefunc.make_basis
    return (
        make(radial, dim=2, rank=1, n_features=count)
        & make(lambda x, *, v: -v, dim=2, rank=1, needs_v=True)
        & make(lambda x: direction + 0.0 * x, dim=2, rank=1)
    )
