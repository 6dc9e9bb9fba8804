"""Trajectories of systems: provenance, exposure, wandering, any dimension."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from tests.defects import told
from tests.fitted_runs import trap_system

from pinav.actuation import HeldProgramme, LinearResponse
from pinav.dynamics import OverdampedSwimmer
from pinav.forces import HarmonicTrap, RollingPropulsion, ZeroForce
from pinav.scenarios import paper, source_system
from pinav.systems import Observation, System, WanderingVelocity
from pinav.trajectories import simulate

KEY = jax.random.key(3)


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_a_bead_in_a_trap_relaxes_in_any_dimension(dim):
    data = simulate(trap_system(dim))
    assert data.channels == ("x", "y", "z")[:dim]
    decay = np.exp(-2.0 * data.times)[..., None]
    assert_allclose(data.states, data.states[:, :1] * decay, atol=1e-9)


def test_the_provenance_gives_the_system_back():
    system = trap_system(2)
    assert eqx.tree_equal(source_system(simulate(system).provenance), system)
    assert source_system({"scenario": "paper"}).name == "paper"
    assert source_system({"scenario": "gone"}) is None
    assert source_system({}) is None


def test_a_changed_scenario_is_not_taken_for_the_built_in_one():
    weak = paper().with_truth(HarmonicTrap(1.0, [5.0, 5.0]))
    weak = eqx.tree_at(lambda s: s.times, weak, weak.times[:11])
    again = source_system(simulate(weak).provenance)
    assert isinstance(again.environment, HarmonicTrap)


def test_an_exposure_averages_before_the_noise():
    sharp = trap_system(1)
    blurred = trap_system(1, observation=Observation(exposure=0.1))
    middle = simulate(sharp).states[:, 1:-1]
    factor = np.sinh(0.1) / 0.1  # the mean of exp(-2 s) over t -+ 0.05
    assert_allclose(simulate(blurred).states[:, 1:-1], factor * middle, rtol=1e-3)


def drifter(**parts):
    """A swimmer of mobility 1 without any force."""
    return System(
        name="drifter",
        swimmer=OverdampedSwimmer(ZeroForce(), ZeroForce(), 1.0),
        dim=2,
        environment=ZeroForce(),
        **parts,
    )


@pytest.mark.slow
def test_increments_of_a_blurred_brownian_path_have_the_law_of_blur():
    """Variance 2 D (t - T / 3), covariance D T / 3, and nothing two steps apart."""
    interval, exposure, diffusion = 0.1, 0.08, 0.5
    system = drifter(
        thermal_energy=diffusion,
        observation=Observation(exposure=exposure),
        starts=jnp.zeros((40, 2)),
        times=jnp.linspace(0.0, 400 * interval, 401),
    )
    steps = np.diff(simulate(system, key=KEY).states[:, 1:-1], axis=1)
    lags = [
        (steps[:, lag:] * steps[:, : steps.shape[1] - lag]).mean() for lag in (0, 1, 2)
    ]
    unit = 2 * diffusion * interval
    expected = [1 - exposure / interval / 3, exposure / interval / 6, 0.0]
    assert_allclose(np.array(lags) / unit, expected, atol=0.02)


@pytest.mark.slow
def test_a_wandering_velocity_spreads_as_its_process_does():
    still = WanderingVelocity(still=0.7, driven=0.0, memory=0.5)
    system = drifter(
        wandering=still, starts=jnp.zeros((600, 2)), times=jnp.linspace(0.0, 4.0, 21)
    )
    data = simulate(system, key=KEY)
    t = data.times[0]
    variance = 2 * 0.7**2 * 0.5 * (t - 0.5 * (1 - np.exp(-t / 0.5)))
    assert_allclose((data.states**2).mean(axis=(0, 2))[1:], variance[1:], rtol=0.12)
    with told("'drifter' is stochastic; pass key="):
        simulate(system)


def test_commands_of_a_programme_are_recorded():
    programme = HeldProgramme(
        *(jnp.asarray(a) for a in ([0.0, 1.0], [2.0, 3.0], [0.0, 0.5]))
    )
    rolling = RollingPropulsion(jnp.eye(2), LinearResponse(), programme)
    system = trap_system(2)
    system = eqx.tree_at(lambda s: s.swimmer.propulsion, system, rolling)
    data = simulate(system)
    assert_array_equal(data.commands["frequency"][0][[0, 9, 10]], [2, 2, 3])
    assert_array_equal(data.commands["heading"][0][[9, 10]], [0.0, 0.5])


def test_what_a_simulation_needs_is_named():
    system = trap_system(2)
    unknown = eqx.tree_at(
        lambda s: s.environment, system, None, is_leaf=lambda x: x is None
    )
    with told("'bead': its true environment is not stated"):
        simulate(unknown)
    timeless = eqx.tree_at(lambda s: s.times, system, system.times[:0])
    with told(r"'bead': expected \[times\] for a simulation"):
        simulate(timeless)
