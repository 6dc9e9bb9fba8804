"""Clean trajectories of a system from starts that no fit has seen."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.systems import Observation, System
from pinav.trajectories import Trajectories, simulate

HELD_OUT, HELD_OUT_SEED = 64, 64_000
"""How many, and the key of their starts, which `pinav simulate` never draws from."""


def held_out(
    system: System, *, until: float | None = None, count: int = HELD_OUT
) -> Trajectories:
    """Solutions of the truth without observation noise, for scoring.

    Starts are drawn by the system's rule; that of `paper`, which has a single start,
    is the ring of `barrier-crossings` around its barrier. Stochastic truths give
    realisations of their own Brownian motion.

    Args:
        system: with its true environment and a rule that draws starts.
        until: time [T] since the start up to which to solve, sampled as the system
            is; its own unless given.
        count: number of trajectories.

    Raises:
        InputError: the truth is not stated, or no rule draws starts.
    """
    key = jax.random.key(HELD_OUT_SEED)
    system = system.with_starts(key, count)
    system = dataclasses.replace(system, observation=Observation())
    if until is not None:
        system = dataclasses.replace(system, times=_times(system, until))
    return simulate(system, key=jax.random.fold_in(key, 1))


def _times(system: System, until: float) -> Float[Array, " time"]:
    first, step = float(system.times[0]), float(system.times[1] - system.times[0])
    return jnp.asarray(first + step * np.arange(round(until / step) + 1))
