"""Commands of a trajectory drive a model, whatever they are and however they lag."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav.actuation import HeldProgramme, LinearResponse, SlippingResponse
from pinav.dynamics import (
    FixedStep,
    OverdampedSwimmer,
    drive_by_arrays,
    rollout,
    takes_commands,
    unbound,
)
from pinav.errors import InputError
from pinav.evaluation import predict
from pinav.forces import (
    HarmonicTrap,
    RollingPropulsion,
    SumForce,
    UniformFlow,
    ZeroForce,
)
from pinav.trajectories import Trajectories

GAIN = jnp.array([[2.0, 0.1], [-0.1, 3.0]])
RESPONSE = SlippingResponse(3.0, 0.4)
TIMES = np.arange(0.0, 6.0, 0.1)
COMMANDS = {
    "frequency": np.where(TIMES < 3, 2.0, 5.0),
    "heading": np.floor(TIMES) * 0.7,
}


def driven_by(model, piece):
    return drive_by_arrays(model, piece.times, piece.commands)


def swimmer(environment=None, **fields):
    propulsion = RollingPropulsion(GAIN, RESPONSE, **fields)
    environment = ZeroForce() if environment is None else environment
    return OverdampedSwimmer(propulsion, environment, 1.0, UniformFlow([0.5, -0.2]))


def observed(count=1, times=TIMES):
    return Trajectories.from_arrays(
        [times + i for i in range(count)],
        [np.zeros((len(times), 2))] * count,
        channels=("x", "y"),
        commands={
            "frequency": [COMMANDS["frequency"]] * count,
            "heading": [COMMANDS["heading"] + i for i in range(count)],
        },
    )


PROGRAMME = HeldProgramme(jnp.asarray(TIMES), *map(jnp.asarray, COMMANDS.values()))


@pytest.mark.parametrize("lag", [0.0, 0.3])
def test_a_commanded_swimmer_goes_along_the_integral_of_its_commands(lag):
    data, delay = observed(), 0.25
    model = driven_by(swimmer(delay=delay, lag=lag), data.trajectory(0))
    # exact at the commands' times only where there is a lag, so compare there
    at = TIMES + delay if lag else TIMES
    run = rollout(model, jnp.zeros(2), np.concatenate([[-1.0], at]))
    cycles = PROGRAMME.lagged_integral(RESPONSE, jnp.asarray(at) - delay, lag or 1e-12)
    drift = (at - at[0])[:, None] * jnp.array([[0.5, -0.2]])
    moved = run.ys[1:] - run.ys[1:2]
    np.testing.assert_allclose(moved, (cycles - cycles[:1]) @ GAIN.T + drift, atol=1e-9)


@pytest.mark.slow
def test_predictions_are_driven_by_each_trajectory_of_its_own():
    data = observed(3)
    model = swimmer(HarmonicTrap(stiffness=0.3, center=[0.0, 0.0]), delay=0.15, lag=0.2)
    states, _ = predict(model, data)
    own = rollout(driven_by(model, data.trajectory(1)), jnp.zeros(2), TIMES + 1)
    np.testing.assert_allclose(states[1], own.ys, atol=1e-8)
    assert np.abs(states[0] - states[1]).max() > 0.1


@pytest.mark.slow
def test_a_window_is_driven_by_what_was_commanded_before_it():
    whole = observed()
    model = swimmer(delay=0.45)
    path, _ = predict(model, whole)
    window = Trajectories.from_arrays(TIMES[12:40], path[0, 12:40], channels=("x", "y"))
    states, _ = predict(model, window, driven_by=whole)
    np.testing.assert_allclose(states[0], path[0, 12:40], atol=1e-8)


def test_commands_reach_a_propulsion_anywhere_in_a_model():
    inner = RollingPropulsion(GAIN, LinearResponse())
    model = OverdampedSwimmer(SumForce((inner, ZeroForce())), ZeroForce(), 1.0)
    assert takes_commands(model)
    assert unbound(model) is inner
    bound = driven_by(model, observed().trajectory(0))
    assert not takes_commands(bound)
    assert driven_by(bound, observed().trajectory(0)) is bound


@pytest.mark.slow
def test_a_path_is_differentiable_by_response_and_lag():
    piece, lag = observed().trajectory(0), 0.1
    start = swimmer(delay=jnp.asarray(0.2), lag=jnp.asarray(lag))

    def end(model):
        driven = driven_by(model, piece)
        return rollout(driven, jnp.zeros(2), TIMES[:21], solver=FixedStep()).ys[-1, 0]

    slope = eqx.filter_grad(end)(start).propulsion
    moved = [
        end(eqx.tree_at(lambda m: m.propulsion.lag, start, jnp.asarray(lag + change)))
        for change in (1e-5, -1e-5)
    ]
    np.testing.assert_allclose(slope.lag, (moved[0] - moved[1]) / 2e-5, rtol=1e-4)
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(slope))


def test_what_is_missing_is_named():
    piece = observed().trajectory(0)
    bare = eqx.tree_at(lambda p: p.commands, piece, {})
    with pytest.raises(InputError, match="frequency and heading not recorded"):
        driven_by(swimmer(), bare)
    with pytest.raises(InputError, match="bind those of a trajectory"):
        rollout(swimmer(), jnp.zeros(2), TIMES)
    with pytest.raises(InputError, match="lag: expected 0 beside a programme"):
        RollingPropulsion(GAIN, RESPONSE, PROGRAMME, lag=0.1)
