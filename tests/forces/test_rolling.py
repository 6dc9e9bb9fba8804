"""Commands, responses and the rolling propulsion."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from tests.refusals import refusals

from pinav import actuation
from pinav.dynamics import Adaptive, OverdampedSwimmer, rollout
from pinav.forces import (
    RollingPropulsion,
    UniformFlow,
    ZeroForce,
    heading_offset,
    mean_gain,
)

RESPONSES = {
    "linear": actuation.LinearResponse(),
    "saturating": actuation.SaturatingResponse(3.0),
    "slipping": actuation.SlippingResponse(3.0, 0.4),
    "step-out": actuation.StepOutResponse(3.0),
}
TIMES = jnp.array([0.0, 0.5, 1.2, 2.0, 3.0])
FREQUENCY = jnp.array([1.0, 2.0, 2.0, 0.5, 4.0])
HEADING = jnp.array([0.2, 1.4, -2.0, 2.9, 3.3])
HELD = actuation.HeldProgramme(TIMES, FREQUENCY, HEADING)


@pytest.mark.parametrize("response", RESPONSES.values(), ids=RESPONSES)
def test_a_response_starts_at_rest_with_slope_one(response):
    assert abs(response(jnp.asarray(0.0))) < 1e-12
    assert jax.grad(response)(1e-4) == pytest.approx(1.0, abs=1e-3)
    places = jnp.linspace(0.0, 20.0, 200)
    assert jnp.all(response(places) <= places + 1e-9)
    assert jnp.all(response(places) >= -1e-9)


def test_responses_at_high_frequency():
    high = jnp.asarray(300.0)
    assert RESPONSES["saturating"](high) == pytest.approx(3.0, rel=1e-3)
    slipping = RESPONSES["slipping"](high)
    assert slipping == pytest.approx(0.4 * 300 + 0.6 * 3, rel=1e-3)
    # Adler: f - sqrt(f^2 - f_c^2), but for the rounded corner.
    assert RESPONSES["step-out"](high) < 0.3


def test_slipping_contains_the_others():
    places = jnp.linspace(0.0, 9.0, 30)
    nearly_linear = actuation.SlippingResponse(1.0, jnp.asarray(1.0))(places)
    np.testing.assert_allclose(nearly_linear, places, atol=1e-12)
    nearly_full = actuation.SlippingResponse(3.0, jnp.asarray(0.0))(places)
    np.testing.assert_allclose(nearly_full, RESPONSES["saturating"](places), atol=1e-9)


test_values_that_make_no_sense_are_refused = refusals(
    (lambda: actuation.SaturatingResponse(-1.0), "corner: expected > 0, got -1"),
    (lambda: actuation.StepOutResponse(-1.0), "corner: expected > 0, got -1"),
    (
        lambda: actuation.SlippingResponse(1.0, 1.0),
        "residual: expected between 0 and 1, got 1.0",
    ),
    (
        lambda: RollingPropulsion(jnp.eye(2)[:, :1], actuation.LinearResponse(), HELD),
        "RollingPropulsion.gain: expected a matrix",
    ),
)


def test_a_held_programme_holds():
    for time, index in [(-1.0, 0), (0.49, 0), (0.5, 1), (1.9, 2), (9.0, 4)]:
        assert HELD(time) == (FREQUENCY[index], HEADING[index])


def test_a_linear_programme_turns_the_short_way():
    programme = actuation.LinearProgramme(
        jnp.array([0.0, 1.0]), jnp.array([1.0, 3.0]), jnp.array([3.0, -3.0])
    )
    frequency, heading = programme(0.5)
    assert frequency == 2.0
    assert jnp.cos(heading) == pytest.approx(-1.0)


PROMPT = 1e-9
"""A lag that is none."""


def test_the_integral_is_that_of_the_commands():
    response, ts = RESPONSES["saturating"], jnp.array([-0.5, 0.3, 1.7, 3.5])
    fine = np.linspace(-0.5, 3.5, 40_001)
    place = np.searchsorted(TIMES, fine, side="right") - 1
    values = np.asarray(HELD.commands(response))[np.maximum(place, 0)]
    expected = scipy.integrate.cumulative_trapezoid(values, fine, axis=0, initial=0.0)
    expected = expected[np.searchsorted(fine, ts)]
    found = HELD.lagged_integral(response, ts, PROMPT)
    np.testing.assert_allclose(found - found[:1], expected, atol=2e-3)


def test_a_lag_follows_its_differential_equation():
    response, lag = RESPONSES["linear"], 0.4
    fine = np.linspace(0.0, 3.0, 30_001)
    commands = np.asarray(HELD.commands(response))
    follower, path, step = commands[0], [np.zeros(2)], fine[1] - fine[0]
    for place in np.searchsorted(TIMES, fine[:-1], side="right") - 1:
        path.append(path[-1] + step * follower)
        follower = follower + step / lag * (commands[place] - follower)
    found, quick, prompt = (
        HELD.lagged_integral(response, TIMES, jnp.asarray(t))
        for t in (lag, 1e-4, PROMPT)
    )
    expected = np.array(path)[np.searchsorted(fine, np.asarray(TIMES) - 1e-9)]
    np.testing.assert_allclose(found, expected, atol=1e-3)
    np.testing.assert_allclose(quick, prompt, atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, actuation.STRETCH, 3 * actuation.STRETCH + 5])
def test_a_follower_goes_step_by_step_through_any_number_of_commands(count):
    times = jnp.cumsum(jax.random.uniform(jax.random.key(0), (count,)))
    commands = jax.random.normal(jax.random.key(1), (count, 2))
    states = [commands[0]]
    for interval, command in zip(np.diff(times), commands[:-1], strict=True):
        kept = jnp.exp(-interval / 0.7)
        states.append(kept * states[-1] + (1 - kept) * command)
    np.testing.assert_allclose(
        actuation.follow(times, commands, 0.7), jnp.stack(states)
    )


def test_a_rolling_robot_moves_by_gain_delay_and_drift():
    gain = jnp.array([[2.0, 0.1], [-0.1, 3.0]])
    propulsion = RollingPropulsion(gain, RESPONSES["slipping"], HELD, 0.3)
    drift = jnp.array([0.5, -0.2])
    swimmer = OverdampedSwimmer(propulsion, ZeroForce(), 1.0, UniformFlow(drift))
    run = rollout(swimmer, jnp.zeros(2), TIMES, solver=Adaptive(1e-7, 1e-7))
    cycles = HELD.lagged_integral(RESPONSES["slipping"], TIMES - 0.3, PROMPT)
    expected = (cycles - cycles[:1]) @ gain.T + TIMES[:, None] * drift[None]
    np.testing.assert_allclose(run.ys, expected, atol=1e-4)


def test_gain_and_heading_offset_of_a_turned_gain():
    cos, sin = jnp.cos(0.4), jnp.sin(0.4)
    turn = jnp.array([[cos, -sin], [sin, cos]])
    assert heading_offset(3 * turn) == pytest.approx(0.4)
    assert mean_gain(3 * turn) == pytest.approx(3.0)
