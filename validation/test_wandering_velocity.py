"""The velocity that a propulsion does not explain, on paths whose velocity is known."""

import jax
import jax.numpy as jnp
import numpy as np
from tests.identification.test_kalman import disturbance
from tests.identification.test_residual_field import vortex
from validation.wandering_velocity import drift_over_time, smoothed_velocity

from pinav.identification import drift_only, fit_track, tracks, with_slow_drift
from pinav.identification.kalman import transitions


def test_the_drift_over_time_follows_the_velocity():
    passive = tracks(vortex(), pooled=True)[0]
    fit = fit_track(passive, with_slow_drift(drift_only()))
    found = drift_over_time(passive, fit)
    piece = passive.pieces[0]
    positions = [np.interp(found.times, piece.times, x) for x in piece.states.T]
    expected = np.stack([-0.5 * positions[1], 0.5 * (positions[0] - 3)], axis=1)
    both = np.corrcoef(found.velocity.ravel(), expected.ravel())[0, 1]
    assert both > 0.6
    assert np.all(found.sd > 0)


def test_smoothed_velocity_of_a_steady_motion_is_its_speed():
    times = jnp.arange(60.0)
    known = disturbance(slow=2.0, slow_memory=1e3, noise=0.01, still=0.05)
    steps = transitions(
        jnp.diff(times), jnp.full(59, 0.05), known, jnp.zeros(59, complex)
    )
    positions = jax.lax.complex(1.5 * times, -0.5 * times)
    velocity, slow, sd = smoothed_velocity(positions, jnp.full(60, 0.05), steps, known)
    np.testing.assert_allclose(velocity[30], [1.5, -0.5], atol=0.01)
    np.testing.assert_allclose(slow[30], velocity[30], atol=0.05)
    assert 0 < sd[30] < 0.1
