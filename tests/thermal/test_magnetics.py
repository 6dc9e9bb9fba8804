"""Particles in a field: printed values, limits of the law, measured tables."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from tests.refusals import refusals

from pinav.thermal.sources import (
    LinearResponse,
    LogNormalSizes,
    TabulatedHeating,
    langevin_ratio,
)

FIELD = (1e4, 1e5)
PRINTED = {  # d: τ_N, τ_B, τ, ξ, χ0, SLP
    10e-9: (8.798386e-9, 1.006581e-6, 8.722147e-9, 0.685312, 9.882935, 412.7681),
    12e-9: (5.185681e-8, 1.502536e-6, 5.012679e-8, 1.184219, 16.15226, 3873.312),
    14e-9: (7.166741e-7, 2.139352e-6, 5.368362e-7, 1.880496, 23.00711, 53102.71),
    16e-9: (2.628199e-5, 2.934640e-6, 2.639872e-6, 2.807038, 29.03779, 97855.14),
}


@pytest.mark.parametrize("diameter", PRINTED)
def test_particles_at_their_printed_values(diameter):
    own = LinearResponse(diameter)
    found = (
        own.neel_time,
        own.brown_time,
        own.relaxation_time,
        own.validity(FIELD[0]),
        own.susceptibility(FIELD[0]),
        own.slp(*FIELD),
    )
    assert [float(v) for v in found] == pytest.approx(PRINTED[diameter], rel=2e-6)


def test_bound_particles_relax_by_neel_alone():
    bound = LinearResponse(14e-9, viscosity=jnp.inf)
    assert float(bound.slp(*FIELD)) == pytest.approx(65646.443, rel=1e-6)
    assert float(bound.relaxation_time) == pytest.approx(float(bound.neel_time))


def test_at_a_fixed_product_the_trend_of_power_turns_round():
    """The Langevin susceptibility falls with H, and wins at high amplitude."""
    own = LinearResponse(12e-9)
    amplitudes = [2e3, 5e3, 10e3, 15e3, 20e3]
    found = [float(own.slp(h, 1e9 / h)) for h in amplitudes]
    printed = [4108.356, 4114.049, 3873.312, 3538.653, 3186.656]
    assert found == pytest.approx(printed, rel=1e-6)


def test_the_langevin_ratio_is_smooth_through_zero():
    x = jnp.array([0.0, 0.00999, 0.01001, 0.5])
    closed = 3 / x[1:] * (1 / jnp.tanh(x[1:]) - 1 / x[1:])
    found = langevin_ratio(x)
    assert float(found[0]) == 1.0
    assert np.asarray(found[1:]) == pytest.approx(np.asarray(closed), rel=1e-9)
    assert float(jax.grad(langevin_ratio)(jnp.asarray(0.0))) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("spread", [0.05, 0.1, 0.2])
def test_sizes_are_averaged_by_mass(spread):
    z = np.linspace(-8, 10, 721)
    sizes = 12e-9 * np.exp(spread * z)
    shares = sizes**3 * np.exp(-0.5 * z**2)
    powers = [float(LinearResponse(float(size)).slp(*FIELD)) for size in sizes]
    whole, heat = (
        scipy.integrate.simpson(own, x=z) for own in (shares, powers * shares)
    )
    found = LogNormalSizes(LinearResponse(12e-9), spread).slp(*FIELD)
    assert float(found) == pytest.approx(heat / whole, rel=1e-6)


def test_a_narrow_distribution_is_its_median():
    own = LinearResponse(13e-9)
    narrow = LogNormalSizes(own, 1e-4)
    assert float(narrow.slp(*FIELD)) == pytest.approx(float(own.slp(*FIELD)), rel=1e-4)
    assert float(narrow.validity(1e4)) == pytest.approx(float(own.validity(1e4)))


def test_a_table_of_a_law_repeats_it_at_its_nodes_and_falls_below_them():
    own = LinearResponse(12e-9)
    amplitudes, frequencies = [2e3, 4e3, 8e3], [1e5, 2e5]
    slps = [[own.slp(h, f) for f in frequencies] for h in amplitudes]
    table = TabulatedHeating(amplitudes, frequencies, slps)
    assert float(table.slp(4e3, 2e5)) == pytest.approx(float(own.slp(4e3, 2e5)))
    low = float(table.slp(1e3, 1e5)) / float(table.slp(2e3, 1e5))
    assert low == pytest.approx(0.25)
    assert float(table.slp(0.0, 1e5)) == 0.0
    assert float(table.validity(1.6e4)) == pytest.approx(2.0)


test_bad_particles_are_refused = refusals(
    (lambda: LinearResponse(-1e-9), r"LinearResponse.diameter: expected > 0"),
    (lambda: LinearResponse(14.0), r"expected metres, such as 14e-9, got 14.0"),
    (lambda: LogNormalSizes(LinearResponse(1e-8), 0.0), r"spread: expected > 0"),
    (
        lambda: TabulatedHeating(
            jnp.array([2.0, 1.0]), jnp.array([1.0]), jnp.ones((2, 1))
        ),
        r"amplitudes: expected increasing numbers > 0, got \[2.0, 1.0\]; sort",
    ),
)
