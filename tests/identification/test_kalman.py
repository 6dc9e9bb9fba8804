"""The filter against dense Gaussian covariances, and laws of its transitions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav.identification.kalman import Disturbance, innovations, transitions
from pinav.systems import WanderingVelocity

TIMES = jnp.array([0.0, 0.4, 1.0, 1.1, 2.5, 3.0, 4.2])
FIRST = jnp.array([1.0, 0, 0, 0, 0, 0, 0])


def disturbance(gain_wander=0.0, **changes):
    wandering = {"still": 0.4, "driven": 0.9, "memory": 1.3}
    wandering |= {"slow": 0.3, "slow_memory": 9.0} | changes
    return Disturbance(
        WanderingVelocity(**jax.tree.map(jnp.asarray, wandering)),
        gain_wander=jnp.asarray(gain_wander),
        gain_memory=jnp.asarray(20.0),
        noise=jnp.asarray(0.2),
    )


def steps_of(known, strength, times=TIMES, cycles=None):
    """Transitions of a strength that is the same at all times."""
    count = len(times) - 1
    cycles = jnp.zeros(count, complex) if cycles is None else cycles
    return transitions(jnp.diff(times), jnp.full(count, strength), known, cycles)


def integrated_covariance(times, memory):
    """Covariance of the integral of an Ornstein-Uhlenbeck process of variance 1."""
    a, b = times[:, None], times[None]
    decays = np.exp(-a / memory) + np.exp(-b / memory) - np.exp(-abs(a - b) / memory)
    return 2 * memory * np.minimum(a, b) + memory**2 * (decays - 1)


DIFFERENCES = np.concatenate([-np.ones((6, 1)), np.eye(6)], axis=1)
"""To the first observation: the start is unknown, and these are what is known."""


def dense(turned):
    """Covariance of differences, either part, with a gain that may wander."""
    times = np.asarray(TIMES)
    decays = np.exp(-abs(times[:, None] - times) / 20.0)
    along = 0.5 * np.tril(np.ones((7, 7)), -1) * np.append(turned, 0.0)
    whole = 0.7**2 * integrated_covariance(times, 1.3) + 0.2**2 * np.eye(7)
    whole = whole + 0.3**2 * integrated_covariance(times, 9.0)
    return DIFFERENCES @ (whole + along @ decays @ along.conj().T) @ DIFFERENCES.T


@pytest.mark.parametrize("wanders", [False, True])
def test_likelihood_is_that_of_the_dense_covariance(wanders):
    """Its squares and its volume, of a gain that is constant or wanders."""
    known = disturbance(gain_wander=0.5 * wanders)
    real, imaginary = jax.random.normal(jax.random.key(3), (2, 7))
    values = jax.lax.complex(real, imaginary)
    turned = jax.lax.complex(imaginary, 2 * real)[:6]
    steps = steps_of(known, 0.7, cycles=turned)
    found = innovations(values[:, None], jnp.ones(7), FIRST, steps, known.noise)
    covariance, moved = (
        dense(wanders * np.asarray(turned)),
        DIFFERENCES @ np.asarray(values),
    )
    squares = (moved.conj() @ np.linalg.solve(covariance, moved)).real
    whitened = found.columns[:, 0]
    np.testing.assert_allclose(jnp.vdot(whitened, whitened).real, squares, rtol=1e-9)
    volume = np.linalg.slogdet(covariance)[1]
    np.testing.assert_allclose(found.log_variance.sum(), volume, rtol=1e-9)


def test_filter_is_linear_and_ignores_padding():
    known = disturbance(gain_wander=0.5)
    turned = jax.random.normal(jax.random.key(2), (6,), complex)
    steps = steps_of(known, 0.7, cycles=turned)
    columns = jax.random.normal(jax.random.key(0), (7, 2), complex)
    both = jnp.concatenate([columns, (2 * columns[:, :1] - columns[:, 1:])], axis=1)
    found = innovations(both, jnp.ones(7), FIRST, steps, known.noise).columns
    np.testing.assert_allclose(found[:, 2], 2 * found[:, 0] - found[:, 1], atol=1e-12)
    present = jnp.array([1.0, 1, 1, 1, 1, 0, 0])
    spoilt = both.at[5:].set(1e6)
    short = innovations(spoilt, present, FIRST, steps, known.noise)
    np.testing.assert_allclose(short.columns[:4], found[:4])
    assert not short.columns[4:].any()
    assert not short.log_variance[4:].any()


def test_two_transitions_make_one():
    known = disturbance()
    halves = steps_of(known, 0.8, jnp.array([0.0, 0.5, 1.2]))
    whole = steps_of(known, 0.8, jnp.array([0.0, 1.2]))
    first, second = halves.matrix.real
    np.testing.assert_allclose(second @ first, whole.matrix[0], rtol=1e-12)
    noise = second @ halves.noise[0] @ second.T + halves.noise[1]
    np.testing.assert_allclose(noise, whole.noise[0], rtol=1e-9, atol=1e-12)


def test_short_intervals_do_not_cancel():
    known = disturbance(memory=1e5, slow=0.0)
    steps = steps_of(known, 1.0, jnp.array([0.0, 1e-3]))
    np.testing.assert_allclose(steps.noise[0, 0, 0], 2 / 3 * 1e-9 / 1e5, rtol=1e-2)


@pytest.mark.parametrize("quiet", ["still", "driven"])
def test_strength_grows_with_the_drive(quiet):
    strength = disturbance(**{quiet: 0.0}).wandering.strength(
        jnp.array([0.0, 1.0, 16.0])
    )
    expected = [0, 0.9, 1.8] if quiet == "still" else [0.4, 0.4, 0.4]
    np.testing.assert_allclose(strength, expected, atol=1e-12)


def test_a_new_segment_forgets_the_one_before():
    known = disturbance()
    steps = steps_of(known, 0.7)
    columns = jax.random.normal(jax.random.key(1), (7, 1), complex)
    begins = FIRST.at[3].set(1.0)
    both = innovations(columns, jnp.ones(7), begins, steps, known.noise)
    tail = steps_of(known, 0.7, TIMES[3:])
    alone = innovations(columns[3:], jnp.ones(4), FIRST[:4], tail, known.noise)
    np.testing.assert_allclose(both.columns[3:], alone.columns)
    np.testing.assert_allclose(both.log_variance[3:], alone.log_variance)
    assert both.columns[2] == 0
