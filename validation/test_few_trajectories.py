"""Whether one to four trajectories tell a force that turns from one that does not.

Systems of the benchmark of trainers, noise 0.01, and the same swimmers in a swirl at
the place of their barrier. The rule was found on the keys 0 to 6 (even); those below
had no part in it.
"""

import equinox as eqx
import jax
import numpy as np
import pytest
from benchmarks.trainer.systems import benchmark_system

from pinav.fitting import fit_structured
from pinav.fitting.environments.kernels import kernel_environment
from pinav.forces import KernelMixture, KernelPotential, forces_at, gaussian_swirl
from pinav.systems import System
from pinav.trajectories import simulate

JUDGED = (61, 63, 65, 67)


def of_key(key: int, *, turns: bool) -> System:
    drawn = benchmark_system(key)
    swirl = gaussian_swirl(2.0 / drawn.width**0.5, [5.0, 5.0], drawn.width)
    system = drawn.system.with_truth(swirl) if turns else drawn.system
    return eqx.tree_at(lambda s: s.observation.noise, system, 0.01)


def told(key: int, *, turns: bool) -> tuple[bool, float]:
    """Whether the fit has a rotational part, and its error at the samples."""
    system = of_key(key, turns=turns)
    data = simulate(system, key=jax.random.key(key))
    kernels = kernel_environment(KernelPotential, data)
    model = system.swimmer.with_environment(kernels)
    found = fit_structured(model, data, weigh_rotation=True, throw=False)
    force = found.fit.model.environment
    places = data.positions[data.observed[..., :2].all(axis=-1)]
    times = np.zeros(len(places))
    assert system.environment is not None
    true = forces_at(system.environment, times, places)
    miss = forces_at(force, times, places) - true
    error = float(np.linalg.norm(miss) / np.linalg.norm(true))
    print(
        f"{key}, turns: {turns}; {force.kind}, {found.rotation:.0f} nats, {error:.2%}"
    )
    return isinstance(force, KernelMixture), error


@pytest.mark.parametrize("key", JUDGED)
def test_no_force_with_a_potential_is_said_to_turn(key):
    assert not told(key, turns=False)[0]


@pytest.mark.parametrize("key", [61, 65])
def test_a_swirl_that_kernels_resolve_is_told(key):
    turns, error = told(key, turns=True)
    assert turns
    assert error < 0.01
