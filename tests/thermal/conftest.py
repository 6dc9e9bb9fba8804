"""Models of the reference medium, of a kind with the exact solutions."""

import pytest
from validation.heat.checks import powers, reference_model


@pytest.fixture(scope="session")
def medium():
    """Bioheat of set S on a grid, heated by a power density."""
    return reference_model


@pytest.fixture(scope="session")
def switched():
    """A protocol of powers, one for each interval, relative to the power density."""
    return powers
