"""Clean trajectories of a system from starts that no fit has seen."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.scenarios import scenario
from pinav.scenarios.crossings import RING
from pinav.systems import Observation, System
from pinav.trajectories import Trajectories, simulate

HELD_OUT, HELD_OUT_SEED = 64, 64_000
"""How many, and the key of their starts, which `pinav simulate` never draws from."""


def held_out(
    truth: str | System, *, until: float | None = None, count: int = HELD_OUT
) -> Trajectories:
    """Solutions of the truth without observation noise, for scoring.

    Stochastic truths give realisations of their own Brownian motion.

    The single start of `paper` is replaced by shots from a ring around its barrier, as
    in `barrier-crossings`.

    Args:
        truth: a system with starts, or the name of a scenario. Where no rule draws its
            starts, they are those that it states.
        until: time [T] since the start up to which to solve, sampled as the scenario
            is; its own unless given.
        count: number of trajectories.

    Raises:
        InputError: the scenario is unknown, or its truth is not stated.
    """
    key = jax.random.key(HELD_OUT_SEED)
    system = scenario(truth) if isinstance(truth, str) else truth
    if system.rule is not None:
        system = system.with_starts(key, count)
    elif system.name == "paper":
        starts = RING.draw(system.order, key, count)
        system = dataclasses.replace(system, starts=starts)
    system = dataclasses.replace(system, observation=Observation())
    if until is not None:
        system = dataclasses.replace(system, times=_times(system, until))
    return simulate(system, key=jax.random.fold_in(key, 1))


def _times(system: System, until: float) -> Float[Array, " time"]:
    first, step = float(system.times[0]), float(system.times[1] - system.times[0])
    return jnp.asarray(first + step * np.arange(round(until / step) + 1))
