import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav.errors import InputError
from pinav.forces import KernelPotential, LayeredPotential

WIDE = KernelPotential(jnp.array([0.7, -0.2]), jnp.array([[0.0, 0.0], [2.0, 1.0]]), 1.5)
NARROW = KernelPotential(jnp.array([0.4]), jnp.array([[0.5, 0.3]]), 0.3)


def test_layers_add_up_and_their_force_is_the_slope_of_their_potential():
    layered, x = LayeredPotential((WIDE, NARROW)), jnp.array([0.4, 0.6])
    at = (0.0, x, jnp.zeros(2))
    assert jnp.allclose(layered(*at), WIDE(*at) + NARROW(*at), rtol=1e-12)
    slope = jax.grad(lambda x: layered.potential(0.0, x))(x)
    np.testing.assert_allclose(layered(*at), -slope, rtol=1e-12)


def test_one_layer_is_a_kernel_potential():
    at = (0.0, jnp.array([0.4, 0.6]), jnp.zeros(2))
    assert jnp.array_equal(LayeredPotential((WIDE,))(*at), WIDE(*at))


def test_layers_of_two_spaces_are_refused():
    line = KernelPotential(jnp.array([0.4]), jnp.array([[0.5]]), 0.3)
    message = r"LayeredPotential.layers: expected one or more, of one dimension"
    for layers in ((), (WIDE, line)):
        with pytest.raises(InputError, match=message):
            LayeredPotential(layers)
