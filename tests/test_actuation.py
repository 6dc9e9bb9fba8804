import jax
import jax.numpy as jnp
import numpy as np

from pinav.actuation import RotatingField


def test_a_rotating_field_turns_in_its_plane_at_its_frequency():
    times = jnp.linspace(-1.0, 3.0, 17)
    values = jax.vmap(RotatingField(amplitude=2.5, frequency=3.0))(times)
    circle = np.stack([np.cos(3 * times), np.sin(3 * times), 0 * times], axis=1)
    np.testing.assert_allclose(values, 2.5 * circle, atol=1e-14)
