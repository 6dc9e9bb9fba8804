"""The paths of a scenario's truth, before anybody observes them."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float64, PRNGKeyArray

from pinav.dynamics import Adaptive, BrownianSwimmer, rollout, sample_path
from pinav.errors import InputError
from pinav.systems import System

SUBSTEPS = 8
"""Steps of a stochastic truth between two observations."""


def true_paths(
    scenario: System, key: PRNGKeyArray | None
) -> tuple[Float64[np.ndarray, "trajectory time state"], dict[str, Any]]:
    """States at the times of a scenario, and the method by which they were found.

    Args:
        scenario: the true system.
        key: random key of Brownian motion; unused where there is none.

    Raises:
        InputError: the truth is stochastic and there is no key.
    """
    truth = scenario.truth
    if isinstance(truth, BrownianSwimmer):
        method = {"solver": "Euler-Maruyama", "substeps": SUBSTEPS}
        return _sampled(scenario, truth, key), method
    solver = Adaptive()
    solve = eqx.filter_jit(rollout)
    runs = [solve(truth, y0, scenario.times, solver=solver) for y0 in scenario.starts]
    name = type(solver.method).__name__
    method = {"solver": name, "rtol": solver.rtol, "atol": solver.atol}
    return np.stack([run.ys for run in runs]), method


def _sampled(
    scenario: System, truth: BrownianSwimmer, key: PRNGKeyArray | None
) -> Float64[np.ndarray, "trajectory time state"]:
    if key is None:
        raise InputError(
            f"simulate: scenario {scenario.name!r} is stochastic; "
            "pass key=jax.random.key(seed)"
        )
    key = jax.random.fold_in(key, 1)  # apart from the noise of observation

    @eqx.filter_jit
    def sample(truth, starts, times, indices):
        def one(y0, index):
            own = jax.random.fold_in(key, index)
            return sample_path(truth, y0, times, key=own, substeps=SUBSTEPS).ys

        return jax.vmap(one)(starts, indices)

    indices = jnp.arange(len(scenario.starts))
    return np.asarray(sample(truth, scenario.starts, scenario.times, indices))
