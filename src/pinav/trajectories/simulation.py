"""Trajectories of a scenario, with observation noise."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray

from pinav import __version__
from pinav.errors import InputError
from pinav.scenarios import true_paths
from pinav.systems import System
from pinav.trajectories.trajectories import Trajectories


def simulate(scenario: System, *, key: PRNGKeyArray | None = None) -> Trajectories:
    """Solve the truth from every start of a system and observe it, with its noise.

    Args:
        scenario: the system, with its true environment, starts and times.
        key: random key of observation noise and Brownian motion, where there are any.

    Raises:
        InputError: JAX or the system is in float32, a noise has no key, or the system
            states no true environment, no starts or no times.
    """
    scenario.check_simulated()
    if jnp.result_type(float) != jnp.float64 or scenario.starts.dtype != jnp.float64:
        raise InputError(
            "simulate: expected float64; call jax.config.update("
            '"jax_enable_x64", True) before the scenario is made'
        )
    shape = (len(scenario.starts), len(scenario.times), len(scenario.channels))
    noise = _observation_noise(scenario, key, shape)
    states, method = true_paths(scenario, key)
    return Trajectories.from_arrays(
        scenario.times,
        states + noise,
        channels=scenario.channels,
        units=scenario.units,
        provenance={
            "scenario": scenario.name,
            "noise": scenario.noise,
            "key": None if key is None else jax.random.key_data(key).tolist(),
            **method,
            "pinav": __version__,
        },
    )


def _observation_noise(
    scenario: System, key: PRNGKeyArray | None, shape: tuple[int, ...]
) -> np.ndarray:
    if scenario.noise == 0:
        return np.zeros(shape)
    if key is None:
        raise InputError(
            f"simulate: scenario {scenario.name!r} adds noise of {scenario.noise}; "
            "pass key=jax.random.key(seed)"
        )
    return scenario.noise * np.asarray(jax.random.normal(key, shape))
