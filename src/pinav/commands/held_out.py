"""Clean trajectories of a scenario from starts that no fit has seen."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pinav.scenarios import scenario
from pinav.scenarios.crossings import RING
from pinav.systems import System
from pinav.trajectories import Trajectories, simulate

HELD_OUT, HELD_OUT_SEED = 64, 64_000
"""How many, and the key of their starts, which `pinav simulate` never draws from."""


def held_out(
    name: str, *, until: float | None = None, count: int = HELD_OUT
) -> Trajectories:
    """Noise-free solutions of the truth, for scoring.

    The single start of `paper` is replaced by shots from a ring around its barrier, as
    in `barrier-crossings`.

    Args:
        name: of the scenario.
        until: time [T] since the start up to which to solve, sampled as the scenario
            is; its own unless given.
        count: number of trajectories.

    Raises:
        InputError: the scenario is unknown, or its truth is stochastic.
    """
    key = jax.random.key(HELD_OUT_SEED)
    if name == "paper":
        chosen = scenario(name)
        starts = RING.draw(chosen.order, key, count)
        chosen = eqx.tree_at(lambda s: s.starts, chosen, starts)
    else:
        chosen = scenario(name, key, count=count)
    chosen = eqx.tree_at(lambda s: s.noise, chosen, 0.0)
    if until is not None:
        chosen = eqx.tree_at(lambda s: s.times, chosen, _times(chosen, until))
    return simulate(chosen)


def _times(chosen: System, until: float):
    first, step = float(chosen.times[0]), float(chosen.times[1] - chosen.times[0])
    return jnp.asarray(first + step * np.arange(round(until / step) + 1))
