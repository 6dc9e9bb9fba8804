import jax
import pytest


@pytest.fixture(autouse=True, scope="module")
def standard_promotion():
    """optax raises float32 to integer powers, which strict promotion forbids."""
    with jax.numpy_dtype_promotion("standard"):
        yield
