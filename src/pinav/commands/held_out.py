"""Clean trajectories of a scenario from starts that no fit has seen."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.systems import System
from pinav.trajectories import Trajectories, simulate

HELD_OUT, HELD_OUT_SEED = 64, 64_000
"""How many, and the key of their starts, which `pinav simulate` never draws from."""


def held_out(
    system: System, *, until: float | None = None, count: int = HELD_OUT
) -> Trajectories:
    """Noise-free solutions of the truth, for scoring.

    Starts are drawn by the system's rule; that of `paper`, which has a single start,
    is the ring of `barrier-crossings` around its barrier.

    Args:
        system: with its true environment.
        until: time [T] since the start up to which to solve, sampled as the scenario
            is; its own unless given.
        count: number of trajectories.

    Raises:
        InputError: the truth is not stated or is stochastic, or no rule draws starts.
    """
    key = jax.random.key(HELD_OUT_SEED)
    chosen = system.with_starts(key, count)
    chosen = eqx.tree_at(lambda s: s.observation.noise, chosen, 0.0)
    if until is not None:
        chosen = eqx.tree_at(lambda s: s.times, chosen, _times(chosen, until))
    return simulate(chosen)


def _times(chosen: System, until: float) -> Float[Array, " time"]:
    first, step = float(chosen.times[0]), float(chosen.times[1] - chosen.times[0])
    return jnp.asarray(first + step * np.arange(round(until / step) + 1))
