import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import monitoring

from pinav.arguments import on_device


@pytest.mark.parametrize("dtype", [float, np.float32, int, bool])
def test_an_array_keeps_its_numbers_and_type(dtype):
    numbers = np.arange(7).astype(dtype)
    placed = on_device(numbers)
    assert isinstance(placed, jax.Array)
    assert placed.dtype == numbers.dtype
    np.testing.assert_array_equal(placed, numbers)


def test_an_array_of_jax_is_itself():
    array = jnp.ones(3)
    assert on_device(array) is array


def test_no_program_is_compiled_for_a_new_shape():
    events = []

    def listen(event: str, duration_secs: float, **_: object) -> None:
        events.append(event)

    monitoring.register_event_duration_secs_listener(listen)
    on_device(np.ones((3, 1, 4, 1, 5)))
    assert not any("compile" in event for event in events)
    jnp.zeros((3, 1, 4, 1, 6))  # which does compile one: the listener hears it
    assert any("compile" in event for event in events)
