import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav.actuation import RotatingField

TIMES = jnp.linspace(-1.0, 3.0, 17)


@pytest.fixture
def field():
    return RotatingField(amplitude=2.5, frequency=3.0)


def test_rotating_field_keeps_its_norm_and_its_plane(field):
    values = jax.vmap(field)(TIMES)
    np.testing.assert_allclose(jnp.linalg.norm(values, axis=1), 2.5, rtol=1e-14)
    assert jnp.all(values[:, 2] == 0)


def test_rotating_field_has_its_period_and_no_shorter_one(field):
    period = 2 * np.pi / 3.0
    values, later, half = (
        jax.vmap(field)(TIMES + dt) for dt in (0.0, period, period / 2)
    )
    np.testing.assert_allclose(later, values, atol=1e-13)
    np.testing.assert_allclose(half, -values, atol=1e-13)


def test_rotating_field_turns_at_its_frequency(field):
    slope = jax.jacfwd(field)(0.0)
    np.testing.assert_allclose(slope, [0.0, 2.5 * 3.0, 0.0], atol=1e-14)
