import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import monitoring

from pinav.arguments import on_device
from pinav.errors import InputError
from pinav.navigation import CommandLimits


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


@pytest.mark.parametrize("name", ["max_frequency", "max_turning_rate"])
def test_a_limit_may_be_infinite_and_is_positive(name):
    """Of coils that turn at once, say: that of `CommandLimits(1.0)`."""
    assert CommandLimits(1.0).max_turning_rate == math.inf
    limits = CommandLimits(**{"max_frequency": 1.0, name: math.inf})
    assert getattr(limits, name) == math.inf
    for bad in (0.0, -1.0, math.nan, -math.inf):
        with pytest.raises(InputError, match=rf"CommandLimits\.{name}: expected > 0"):
            CommandLimits(**{"max_frequency": 1.0, name: bad})
