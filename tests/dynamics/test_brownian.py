"""Laws of Brownian motion, each with the error that the sample allows."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.refusals import refusals

from pinav import forces
from pinav.dynamics import (
    BrownianSwimmer,
    Outcome,
    OverdampedSwimmer,
    sample_path,
    thermal_energy,
)

KEY = jax.random.key(5)
WATER = 1 / forces.stokes_drag(1.0, 0.89)
HEAT = thermal_energy(298.15)


def brownian(force=None, mobility=WATER, heat=HEAT):
    environment = forces.ZeroForce() if force is None else force
    return BrownianSwimmer(
        OverdampedSwimmer(forces.ZeroForce(), environment, mobility), heat
    )


@eqx.filter_jit
def ends(swimmer, starts, ts, substeps, key=KEY):
    """Where swimmers are at the last of some times, one key each."""
    keys = jax.random.split(key, starts.shape[0])
    return jax.vmap(
        lambda y0, key: sample_path(swimmer, y0, ts, key=key, substeps=substeps).ys[-1]
    )(starts, keys)


def test_a_bead_of_one_micrometre_in_water():
    np.testing.assert_allclose(HEAT, 4.116e-3, rtol=1e-3)
    np.testing.assert_allclose(1 / WATER, 1.7e-2, rtol=0.02)  # 1.7e-8 N s/m
    diffusion = brownian().diffusion(jnp.zeros(2))
    np.testing.assert_allclose(diffusion, 0.245 * np.eye(2), rtol=3e-3)


def test_a_force_makes_a_drift_and_heat_spreads_along_the_mobility():
    """The mean is M F t, the covariance 2 k_B T M t."""
    count, pull, times = 4000, [0.02, -0.01], jnp.array([0.0, 0.3, 2.5])
    mobility = forces.UniaxialTensor(2 * WATER, WATER, forces.ConstantDirector(0.5))
    swimmer = brownian(forces.ConstantForce(pull), mobility)
    moved = np.asarray(ends(swimmer, jnp.zeros((count, 2)), times, 1))
    matrix = np.asarray(forces.tensor_matrix(mobility, jnp.zeros(2)))
    covariance = 2 * HEAT * matrix * times[-1]
    error = 4 * covariance.max() / np.sqrt(count)
    np.testing.assert_allclose(np.cov(moved.T), covariance, atol=error)
    error = 4 * np.sqrt(covariance.max() / count)
    np.testing.assert_allclose(
        moved.mean(axis=0), matrix @ pull * times[-1], atol=error
    )


@pytest.mark.slow
def test_equipartition_in_a_trap():
    stiffness, count, time = 0.05, 10_000, 2.0  # six relaxation times
    swimmer = brownian(forces.HarmonicTrap(stiffness, [0.0, 0.0]))
    there = ends(swimmer, jnp.zeros((count, 2)), jnp.linspace(0.0, time, 5), 20)
    step = time / 80 * WATER * stiffness
    expected = HEAT / stiffness / (1 - step / 2)  # exact for this scheme
    expected *= 1 - np.exp(-2 * WATER * stiffness * time)
    error = 4 * np.sqrt(2 / count)
    np.testing.assert_allclose(np.var(there, axis=0), expected, rtol=error)


@pytest.mark.slow
def test_boltzmanns_distribution_where_the_mobility_varies():
    """Without its divergence, the swimmers would leave where the mobility is high."""
    mobility = forces.BrinkmanTensor(0.5, 1.0, jnp.array([3.0]), jnp.zeros((1, 1)), 0.7)
    swimmer = brownian(forces.HarmonicTrap(1.0, [0.0]), mobility, 1.0)
    count = 3000
    starts = jax.random.normal(jax.random.key(1), (count, 1))  # stationary already
    there = np.asarray(ends(swimmer, starts, jnp.array([0.0, 1.5]), 150))
    np.testing.assert_allclose(np.var(there), 1.0, atol=4 * np.sqrt(2 / count))
    inside = np.mean(np.abs(there) < 0.5)  # 0.20 without the divergence
    np.testing.assert_allclose(inside, 0.38292, atol=4 * np.sqrt(0.236 / count))


@pytest.mark.parametrize(
    "mobility",
    [2.0, forces.CholeskyTensor.of(jnp.array([[0.5, -0.2], [-0.2, 0.3]]))],
    ids=["isotropic", "tensor"],
)
def test_the_drift_is_that_without_noise_where_the_mobility_is_constant(mobility):
    swimmer = brownian(forces.GaussianBarrier(0.3, [0.2, 0.1], 0.8), mobility)
    x = jnp.array([0.4, -0.3])
    np.testing.assert_allclose(swimmer(0.0, x), swimmer.swimmer(0.0, x), rtol=1e-13)


def test_the_divergence_of_the_mobility_agrees_with_differences():
    tensor = forces.UniaxialTensor(2.0, 0.5, forces.WavyDirector(0.4, 0.8, [0.5, -0.3]))
    swimmer, x, h = brownian(mobility=tensor, heat=1.0), jnp.array([0.4, -0.3]), 1e-5
    columns = [tensor(x + h * e, e) - tensor(x - h * e, e) for e in jnp.eye(2)]
    np.testing.assert_allclose(swimmer(0.0, x), sum(columns) / (2 * h), rtol=1e-8)


@pytest.mark.slow
def test_a_path_belongs_to_its_key_and_converges_with_its_steps():
    """The strong order is one where the mobility is constant."""
    swimmer = brownian(forces.GaussianBarrier(0.1, [0.3, 0.0], 0.7))
    starts, ts = jnp.zeros((100, 2)), jnp.array([0.0, 1.0])
    sampled = {n: ends(swimmer, starts, ts, n) for n in (8, 16, 128)}
    errors = [float(jnp.abs(sampled[n] - sampled[128]).mean()) for n in (8, 16)]
    assert 0.75 < np.log2(errors[0] / errors[1]) < 1.4
    again = ends(swimmer, starts, ts, 8)
    np.testing.assert_array_equal(again, sampled[8])
    assert not np.allclose(ends(swimmer, starts, ts, 8, jax.random.key(6)), again)


def test_without_heat_the_path_is_the_flow():
    resting = OverdampedSwimmer(
        forces.ZeroForce(), forces.ZeroForce(), 1.0, forces.ShearFlow(0.5)
    )
    cold, times = BrownianSwimmer(resting, 0.0), jnp.array([0.0, 0.1, 0.7])
    run = sample_path(cold, jnp.array([0.0, 2.0]), times, key=KEY)
    np.testing.assert_allclose(run.ys[:, 0], times, rtol=1e-12)
    assert run.outcome == Outcome.SUCCESS


test_bad_arguments_are_named = refusals(
    (lambda: brownian(heat=-1.0), "thermal_energy: expected >= 0, got -1.0"),
    (
        lambda: sample_path(brownian(), jnp.zeros(2), jnp.ones(1), key=KEY, substeps=0),
        r"sample_path: .* \(1,\) and 0 substeps",
    ),
)
