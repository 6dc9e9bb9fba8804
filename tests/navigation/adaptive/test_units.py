"""Plans and flights do not depend on the units in which a task is stated."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav import navigation
from pinav.actuation import LinearResponse
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.forces import GaussianBarrier, LinearDrag, ZeroForce
from pinav.navigation.adaptive.flight import fly
from pinav.navigation.adaptive.steering import AdaptiveController


def barrier_task(length, time, *, inertial):
    """Past a barrier and a disc, with one unit of length and one of time."""
    rate = length / time**2 if inertial else length / time
    barrier = GaussianBarrier(
        height=1.8 * rate * length, center=[5 * length, 5.2 * length], width=length
    )
    if inertial:
        truth = Swimmer(ZeroForce(), LinearDrag(0.5 / time), barrier)
        noise, rest = 0.1 * length / time**1.5, [0.0, 0.0]
    else:
        truth = OverdampedSwimmer(ZeroForce(), barrier, 1.0)
        noise, rest = 0.02 * length / time**0.5, []
    return navigation.Task(
        name="units",
        truth=navigation.SteeredSwimmer(
            truth, navigation.RollingActuator(0.8 * rate * jnp.eye(2), LinearResponse())
        ),
        start=jnp.array([length, 5 * length, *rest]),
        objective=navigation.ReachGoal([9.0 * length, 5.0 * length], 0.4 * length),
        limits=navigation.CommandLimits(1.0),
        arena=navigation.Rectangle([-length, -length], [11 * length, 11 * length]),
        keep_out=(navigation.Disc([5.0 * length, 8.0 * length], length),),
        step=0.125 * time,
        time_limit=60 * time,
        noise=noise,
        sensor_noise=0.02 * length,
    )


@pytest.mark.slow
@pytest.mark.parametrize("inertial", [True, False], ids=["inertia", "current"])
def test_flights_in_other_units_are_the_same_flights(inertial):
    """Rounding differs, and a flight makes it grow."""
    key, flights = jax.random.key(3), []
    for length, time in ((1.0, 1.0), (64.0, 0.0625), (0.125, 16.0)):
        adaptive = AdaptiveController.of(
            barrier_task(length, time, inertial=inertial), points=15, speeds=7
        )
        flight, _, _ = fly(adaptive, key=key)
        flights.append(
            (flight.path / length, flight.arrival_time / time, flight.stalls)
        )
    first, *others = flights
    assert np.isfinite(first[1])
    for path, arrival, stalls in others:
        assert abs(len(path) - len(first[0])) <= 1
        for one, other in zip(path, first[0], strict=False):
            np.testing.assert_allclose(one, other, atol=0.1)
        assert arrival == pytest.approx(first[1], rel=0.01)
        assert stalls == first[2]


@pytest.mark.parametrize(
    "inertial",
    [
        pytest.param(True, marks=pytest.mark.slow, id="inertia"),
        pytest.param(False, id="current"),
    ],
)
def test_plans_in_other_units_are_the_same_plans(inertial):
    """Metres and seconds of a microrobot, say: nothing is of order one."""
    times, options = [], {"points": 15, **({"speeds": 7} if inertial else {})}
    for length, time in ((1.0, 1.0), (1e-5, 3.0), (1e4, 0.02)):
        problem = barrier_task(length, time, inertial=inertial)
        plan = navigation.time_to_go(
            problem, navigation.physics_only(problem.truth), **options
        )
        times.append(plan.time_from(problem.start) / time)
    np.testing.assert_allclose(times, times[0], rtol=1e-3)


def test_a_start_in_whole_numbers_is_one_in_real_numbers():
    problem = barrier_task(1.0, 1.0, inertial=False)
    whole = dataclasses.replace(problem, start=jnp.array([1, 5]))
    times = [
        navigation.time_to_go(
            one, navigation.physics_only(one.truth), points=15
        ).time_from(one.start)
        for one in (problem, whole)
    ]
    assert times[0] == times[1] < problem.time_limit
