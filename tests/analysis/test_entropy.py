"""Entropy production of a force that is known, at samples of its steady state."""

import jax.numpy as jnp
import numpy as np
import pytest

from pinav.analysis import entropy_production
from pinav.dynamics import OverdampedSwimmer
from pinav.errors import InputError
from pinav.fitting import Posterior, ravel_model
from pinav.forces import HarmonicTrap, KernelForce, KernelTensor, ZeroForce
from pinav.forces.kernel_basis import KernelBasis

GRID = np.stack(np.meshgrid(*[np.arange(-5.0, 5.1)] * 2), axis=-1).reshape(-1, 2)
DIFFUSION, MOBILITY, STIFFNESS = 0.5, 2.0, 1.0
TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])


def posterior(turning, sd=0.0, mobility=MOBILITY):
    """Kernels that are a trap and a rotation about the origin, by least squares."""
    values = np.exp(-0.5 * ((GRID[:, None] - GRID) ** 2).sum(axis=2) / 1.5**2)
    pull = -STIFFNESS * GRID + turning * GRID @ TURN
    weights = np.linalg.solve(values, pull / MOBILITY)
    force = KernelForce(jnp.asarray(weights), jnp.asarray(GRID), 1.5)
    model = OverdampedSwimmer(ZeroForce(), force, mobility)
    free, theta = ravel_model(model, lambda m: m.environment.weights)
    return Posterior(free, np.asarray(theta), sd**2 * np.eye(len(theta)))


def samples(count=4000):
    """The density of the trap, whatever the rotation."""
    spread = np.sqrt(DIFFUSION / STIFFNESS)
    return spread * np.random.default_rng(1).normal(size=(count, 2))


def produce(turning, count=4000, **options):
    places = samples(count)
    return entropy_production(
        posterior(turning, **options), places, np.full(places.shape, DIFFUSION)
    )


@pytest.mark.parametrize("turning", [0.0, 0.5, 2.0])
def test_a_turning_trap_produces_twice_its_turning_squared_over_the_stiffness(turning):
    entropy = produce(turning)
    true = 2 * turning**2 / STIFFNESS
    assert entropy.rate.value == pytest.approx(true, rel=0.05, abs=0.01)
    assert abs(entropy.rate.value - true) < 3 * entropy.rate.sd + 0.01
    assert entropy.is_significant or turning == 0


def test_the_current_turns_with_the_rotation():
    entropy = produce(2.0)
    expected = 2.0 * entropy.positions @ TURN
    near = np.linalg.norm(entropy.positions, axis=1) < 1.0
    np.testing.assert_allclose(entropy.current[near], expected[near], atol=0.25)


def test_the_doubt_of_the_force_is_taken_off_and_widens_the_interval():
    certain, doubtful = produce(1.0), produce(1.0, sd=0.02)
    assert certain.noise == 0.0
    assert doubtful.noise > 0
    assert doubtful.rate.value == pytest.approx(certain.rate.value - doubtful.noise)
    assert doubtful.rate.sd > certain.rate.sd
    places = samples()
    livelier = entropy_production(
        posterior(1.0, sd=0.02), places, np.full(places.shape, 4 * DIFFUSION)
    )
    assert livelier.noise == pytest.approx(doubtful.noise / 4)


def test_a_learned_mobility_is_the_same_as_a_number():
    level, none = jnp.log(jnp.array([MOBILITY])), jnp.zeros((1, 0))
    tensor = KernelTensor(level, none, KernelBasis.constant(), ((0, 1),))
    number, field = produce(1.0), produce(1.0, mobility=tensor)
    assert field.rate.value == pytest.approx(number.rate.value)


def test_what_has_no_kernels_or_too_few_samples_is_refused():
    with pytest.raises(InputError, match="expected 121 or more samples for 121 kern"):
        produce(1.0, count=50)
    model = OverdampedSwimmer(ZeroForce(), HarmonicTrap(1.0, [0.0, 0.0]), 1.0)
    free, theta = ravel_model(model, lambda m: m.environment.stiffness)
    known = Posterior(free, np.asarray(theta), np.eye(1))
    with pytest.raises(InputError, match="expected a force of kernels, got HarmonicTr"):
        entropy_production(known, samples(), np.ones((4000, 2)))
