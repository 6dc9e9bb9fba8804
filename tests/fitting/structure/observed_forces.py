"""Forces that are observed themselves, with noise, as the response of data."""

import jax.numpy as jnp
import numpy as np

from pinav.fitting.structure.response import ForceResponse
from pinav.forces import forces_at


def observed_forces(truth, places, noise):
    """Every force at the places of each trajectory is observed, with noise."""
    points, times = jnp.asarray(places), jnp.zeros(places.shape[:2])
    forces = np.asarray(forces_at(truth, times, points))
    errors = noise * np.random.default_rng(2).normal(size=forces.shape)
    count = forces[0].size
    return ForceResponse(
        rows=np.eye(count)[None],
        targets=-(forces + errors).reshape(1, -1),
        points=points,
        times=times,
        forces=np.zeros_like(forces),
        num_free=count,
        squares=0.0,
    )
