"""Runs and their limits: what is followed, and what a field may not exceed."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from validation.heat.checks import reference_model

from pinav.errors import InputError
from pinav.thermal.dose import time_to_reach
from pinav.thermal.grids import RadialGrid
from pinav.thermal.heated_run import (
    cuts_through,
    end_of_heating,
    saved_times,
    validity_warnings,
)
from pinav.thermal.perfusion import lang
from pinav.thermal.protocols import (
    ATKINSON_BREZOVICH,
    HERGT_DUTZ,
    HfLimit,
    Piecewise,
    require,
)
from pinav.thermal.sources import LinearResponse, ParticleSource


def steady(product):
    """Four hours at 100 kHz and a product of amplitude and frequency."""
    return Piecewise.constant((0.0, 14400.0), [product / 1e5], 1e5)


def test_a_protocol_above_the_chosen_limit_is_refused_by_name():
    protocol = steady(1e9)
    require(protocol, HERGT_DUTZ)
    with pytest.raises(InputError, match="Atkinson-Brezovich limit: expected <= 4.85e"):
        require(protocol, HERGT_DUTZ, ATKINSON_BREZOVICH)
    require(steady(4.85e8), ATKINSON_BREZOVICH)
    with pytest.raises(InputError, match=r"HfLimit.product: expected > 0 A/\(m s\)"):
        HfLimit(-1.0)


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


def test_what_is_beyond_the_range_of_a_law_is_said():
    grid = RadialGrid.sphere(0.03, 10)
    particles = ParticleSource(5.0 * grid.ball(0.01), LinearResponse(16e-9))
    medium = reference_model(grid, 0.0, None, lang("muscle"))
    model = eqx.tree_at(lambda m: m.sources, medium, (particles,))
    (strained,) = validity_warnings(model, steady(1e9))
    assert "LinearResponse is strained 2.81 times" in strained
    assert validity_warnings(model, steady(1e8)) == []
    assert "60.0 °C is reached" in validity_warnings(model, steady(1e8), 60.0)[0]


def test_every_switch_of_a_burst_is_saved_once():
    bursts = Piecewise.on_off(1e4, 1e5, on=7.0, off=13.0, duration=600.0)
    times = saved_times(bursts)
    assert np.all(np.diff(times) > 1e-3)
    assert np.isin(bursts.edges[1:], times).all()
    assert times[-1] == 600.0
    assert len(times) > 180


@pytest.mark.parametrize(
    ("amplitudes", "end"),
    [
        ([1e4, 5e3, 0.0], 90.0),
        ([0.0, 0.0, 0.0], 600.0),
        # a plan leaves a millionth of its largest amplitude where it is off
        ([1e4, 1e-2, 0.0], 60.0),
    ],
)
def test_heating_ends_where_the_field_is_last_on(amplitudes, end):
    edges = (0.0, 60.0, 90.0, 600.0)
    assert end_of_heating(Piecewise.constant(edges, amplitudes, 1e5)) == end
    ramp = Piecewise.ramp((0.0, 60.0, 90.0), [0.0, 1e4, 0.0], 1e5)
    assert end_of_heating(ramp) == 90.0


def test_time_to_a_dose():
    times, doses = np.array([10.0, 20.0]), np.array([2.0, 4.0])
    for level, time in ((1.0, 10.0), (3.0, 15.0), (4.0, 20.0), (4.1, None)):
        assert time_to_reach(times, doses, level) == time


def test_planes_lie_in_the_middle_of_the_target():
    target = np.zeros((9, 8, 7))
    target[2:5, 4:7, 1:4] = 1.0
    assert cuts_through(target) == ((2, 2), (1, 5), (0, 3))
    assert cuts_through(np.ones((3, 4))) == ((2, None),)
    assert cuts_through(np.ones(4)) == ()


def test_the_product_of_a_ramp_is_that_of_its_higher_end():
    ramp = Piecewise.ramp((0.0, 10.0, 20.0), (1000.0, 3000.0, 2000.0), 2e5)
    products = ATKINSON_BREZOVICH.exposure(ramp)
    np.testing.assert_allclose(products, [6e8, 6e8])
