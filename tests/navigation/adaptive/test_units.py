"""Plans and flights do not depend on the units in which a task is stated."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from pinav import navigation
from pinav.actuation import LinearResponse
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.forces import GaussianBarrier, LinearDrag, ZeroForce


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
