"""Limits of the field: refused by name, and the temperature behind them."""

import jax.numpy as jnp
import pytest

from pinav.errors import InputError
from pinav.thermal.bioheat import Bioheat
from pinav.thermal.boundaries import Dirichlet, outer
from pinav.thermal.grids import RadialGrid
from pinav.thermal.heated_run import validity_warnings
from pinav.thermal.perfusion import lang
from pinav.thermal.protocols import (
    ATKINSON_BREZOVICH,
    HERGT_DUTZ,
    HfLimit,
    Piecewise,
    require,
)
from pinav.thermal.sources import LinearResponse, ParticleSource
from pinav.thermal.tissues import Blood, Tissue

MUSCLE = Tissue(0.49, 1090.0, 3421.0)


def steady(product):
    """Four hours at 100 kHz and a product of amplitude and frequency."""
    return Piecewise.constant((0.0, 14400.0), [product / 1e5], 1e5)


def test_a_protocol_above_the_chosen_limit_is_refused_by_name():
    protocol = steady(1e9)
    require(protocol, HERGT_DUTZ)
    with pytest.raises(InputError, match="Atkinson-Brezovich limit: expected <= 4.85e"):
        require(protocol, HERGT_DUTZ, ATKINSON_BREZOVICH)
    require(steady(4.85e8), ATKINSON_BREZOVICH)


def test_the_limit_leaves_thirty_percent_of_the_power():
    """16 nm particles: 98 W/g at 10 kA/m are 29.6 W/g at the 4.85 kA/m left."""
    amplitude = float(ATKINSON_BREZOVICH.product) / 1e5
    assert amplitude == pytest.approx(4850.0)
    power = float(LinearResponse(16e-9).slp(amplitude, 1e5))
    assert power == pytest.approx(29.6e3, rel=5e-3)


def test_pauses_leave_the_product_as_it_is():
    bursts = Piecewise.on_off(4850.0, 1e5, on=50.0, off=100.0, duration=3600.0)
    largest = float(jnp.max(ATKINSON_BREZOVICH.exposure(bursts)))
    assert largest == pytest.approx(4.85e8)


def test_limits_are_checked():
    with pytest.raises(InputError, match=r"HfLimit.product: expected > 0 A/\(m s\)"):
        HfLimit(-1.0)


def test_what_is_beyond_the_range_of_a_law_is_said():
    grid = RadialGrid.sphere(0.03, 10)
    particles = ParticleSource(5.0 * grid.ball(0.01), LinearResponse(16e-9))
    model = Bioheat(
        grid, MUSCLE, Blood(), lang("muscle"), (particles,), outer(Dirichlet(37.0))
    )
    (strained,) = validity_warnings(model, steady(1e9))
    assert "LinearResponse is strained 2.81 times" in strained
    assert validity_warnings(model, steady(1e8)) == []
    assert "60.0 °C is reached" in validity_warnings(model, steady(1e8), 60.0)[0]
