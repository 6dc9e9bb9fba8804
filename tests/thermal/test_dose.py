"""Dose: the closed form on linear segments, and volumes of a target."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
import scipy.integrate
from validation.heat import exact

from pinav.thermal.dose import (
    LIVER_DAMAGE,
    SKIN_DAMAGE,
    cem43_segment,
    value_exceeded_by,
    volume_above,
)


def ramp(dt, cutoff):
    """Dose of 37 to 45 °C in ten minutes, in steps of `dt` seconds."""
    times = np.linspace(0.0, 600.0, round(600 / dt) + 1)
    temperatures = jnp.asarray(37 + 8 * times / 600)
    begin, end = temperatures[:-1], temperatures[1:]
    return float(cem43_segment(begin, end, dt, cutoff).sum())


@pytest.mark.parametrize(
    ("celsius", "minutes"),
    [(42.0, 15), (43.0, 60), (43.5, 84.8528137424), (44.0, 120), (45.0, 240)],
)
def test_an_hour_at_one_temperature(celsius, minutes):
    found = cem43_segment(jnp.asarray(celsius), jnp.asarray(celsius), 3600.0)
    assert float(found) == pytest.approx(minutes, rel=1e-11)


@pytest.mark.parametrize("cutoff", [37.0, 39.0])
@pytest.mark.parametrize("dt", [1.0, 10.0, 30.0, 60.0, 300.0, 600.0])
def test_a_ramp_is_exact_at_any_step(dt, cutoff):
    """A right rectangle misses by 0.5 % at one second and by 34 % at a minute."""
    true = exact.ramp_dose(37.0, 45.0, 10.0, cutoff)
    assert ramp(dt, cutoff) == pytest.approx(true, rel=1e-9)


def test_a_segment_does_not_depend_on_its_direction_or_division():
    begin, middle, end = jnp.array([35.0, 39.4, 46.0])
    whole = cem43_segment(begin, end, 200.0)
    assert float(cem43_segment(end, begin, 200.0)) == pytest.approx(float(whole))
    share = 200.0 * (39.4 - 35.0) / 11.0
    parts = cem43_segment(begin, middle, share)
    parts += cem43_segment(middle, end, 200.0 - share)
    assert float(parts) == pytest.approx(float(whole), rel=1e-12)


@pytest.mark.parametrize(
    ("damage", "printed"),
    [
        (SKIN_DAMAGE, (5.426979e-6, 2.436739e-5, 9.596522e-4, 1.069220)),
        (LIVER_DAMAGE, (1.958877e-3, 3.627926e-3, 1.637918e-2, 2.914812e-1)),
    ],
)
def test_arrhenius_rates_at_their_printed_values(damage, printed):
    found = damage.rate(jnp.array([43.0, 45.0, 50.0, 60.0]))
    assert np.asarray(found) == pytest.approx(printed, rel=1e-6)


def test_arrhenius_segments_agree_with_quadrature():
    def rate(t):
        return float(SKIN_DAMAGE.rate(jnp.asarray(44.0 + t / 60.0)))

    true, _ = scipy.integrate.quad(rate, 0.0, 60.0)
    found = SKIN_DAMAGE.segment(jnp.asarray(44.0), jnp.asarray(45.0), 60.0)
    assert float(found) == pytest.approx(true, rel=1e-6)


def test_what_ninety_percent_of_a_volume_exceed():
    """A radial profile: T90 is the temperature where the inner 90 % end."""
    edges = np.linspace(0.0, 0.01, 401)
    centers = 0.5 * (edges[1:] + edges[:-1])
    volumes = np.diff(edges**3)
    temperatures = jnp.asarray(45.0 - 3.0 * (centers / 0.01) ** 2)
    found = value_exceeded_by(temperatures, jnp.asarray(volumes), 0.9)
    assert float(found) == pytest.approx(45.0 - 3.0 * 0.9 ** (2 / 3), abs=1e-4)
    share = volume_above(temperatures, jnp.asarray(volumes), 43.0)
    assert float(share) == pytest.approx((2 / 3) ** 1.5, abs=5e-3)


def test_quantiles_leave_out_what_is_not_target_and_differentiate():
    values, weights = jnp.array([50.0, 42.0, 41.0, 40.0]), jnp.array([0.0, 1, 1, 1])
    median = value_exceeded_by(values, weights, 0.5)
    assert float(median) == pytest.approx(41.0)
    slope = jax.grad(lambda v: value_exceeded_by(v, weights, 0.5))(values)
    assert slope.tolist() == pytest.approx([0.0, 0.0, 1.0, 0.0])


def exact_slopes(*at):
    """Derivatives of CEM43 of 60 s by both ends and the cut-off, to eighty digits."""

    def minutes(a, b, c):
        def integral(t):
            if t >= 43:
                steep = (mp.mpf(2) ** (t - 43) - 1) / mp.log(2)
                return steep + 1 / mp.log(4)
            return mp.mpf(4) ** (max(t, c) - 43) / mp.log(4)

        if a == b:  # the mean of a constant rate
            return mp.diff(integral, a)
        return (integral(b) - integral(a)) / (b - a)

    with mp.workdps(80):
        at, step = np.array([mp.mpf(v) for v in at]), mp.mpf(10) ** -20
        shifts = step * np.eye(3, dtype=int)
        changes = [minutes(*(at + s)) - minutes(*(at - s)) for s in shifts]
        return [float(change / (2 * step)) for change in changes]


@pytest.mark.parametrize(
    ("begin", "end"),
    [
        (40.0, 41.0),
        (40.0, 40.001),  # by the series
        (40.0, 40.0199),
        (44.0, 43.99),
        (42.9, 43.2),  # the rate changes
        (36.5, 37.4),  # the cut-off takes a part
        (36.0, 44.0),
        (45.0, 39.0),
        (50.0, 50.0000001),
        (30.0, 31.0),
        (42.0, 42.0),  # the slope of the rate
        *(
            (start, start + gap)  # as in a steady state
            for start in (41.0, 42.9999, 43.5)
            for gap in (0.0, 1e-14, 1e-9, 1e-3, 0.3)
        ),
    ],
)
def test_the_derivatives_of_a_segment_are_exact(begin, end):
    slopes = jax.grad(cem43_segment, argnums=(0, 1, 3))(begin, end, 60.0, 37.0)
    np.testing.assert_allclose(slopes, exact_slopes(begin, end, 37.0), rtol=1e-10)
