"""Optimal times against closed forms and a direct method."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize, root

from pinav.errors import FitError, InputError
from pinav.forces import ShearFlow
from pinav.navigation.task import catalogue as tasks
from pinav.navigation.task.steering import direction
from pinav.navigation.task.task import ReachGoal
from validation import zermelo


@pytest.mark.parametrize("drift", [[0.0, 0.0], [0.5, 0.0], [-0.3, 0.6]])
def test_uniform_drift_is_left_on_a_straight_line(drift):
    """|g - w T| = V T + r."""
    drift, goal = np.array(drift), np.array([3.0, -1.0])
    found = zermelo.quickest(
        lambda x: jnp.asarray(drift),
        jnp.zeros(2),
        jnp.asarray(goal),
        speed=1.2,
        longest=20.0,
        tolerance=0.2,
    )
    left = np.linalg.norm(goal - drift * found.time)
    np.testing.assert_allclose(left, 1.2 * found.time + 0.2, rtol=1e-9)
    np.testing.assert_allclose(found.headings, found.heading, atol=1e-9)


def shear_end(first, time, start, rate):
    """Where an extremal of u = (rate y, 0), V = 1, ends: tan falls as rate t."""
    last = math.atan2(math.sin(first) - rate * time * math.cos(first), math.cos(first))
    sec = [1 / math.cos(a) for a in (first, last)]
    tan = [math.tan(a) for a in (first, last)]
    area = [(s * t + math.asinh(t)) / 2 for s, t in zip(sec, tan, strict=True)]
    y = start[1] + (sec[0] - sec[1]) / rate
    carried = (rate * start[1] + sec[0]) * time - (area[0] - area[1]) / rate
    along = (math.asinh(tan[0]) - math.asinh(tan[1])) / rate
    return np.array([start[0] + carried + along, y])


def test_linear_shear_is_crossed_as_the_closed_form_says():
    """Bryson and Ho, Applied Optimal Control, section 2.7."""
    rate, start, goal = 0.3, np.array([0.0, -1.5]), np.array([4.0, -1.0])
    first, time = root(
        lambda u: shear_end(u[0], u[1], start, rate) - goal, [0.6, 5.0]
    ).x
    flow = ShearFlow(rate)
    found = zermelo.quickest(
        lambda x: flow(0.0, x), jnp.asarray(start), jnp.asarray(goal), speed=1.0,
        longest=15.0,
    )  # fmt: skip
    np.testing.assert_allclose([found.heading, found.time], [first, time], rtol=1e-7)
    tangents = np.tan(found.headings)
    np.testing.assert_allclose(tangents, tangents[0] - rate * found.ts, atol=1e-7)


def direct_time(task, guess, pieces=40, parts=4):
    """Least time by SLSQP over headings that are constant in each piece."""
    goal, tolerance = task.objective.goal, task.objective.tolerance
    frequency = task.limits.max_frequency

    def end(unknown):
        step = unknown[-1] / (pieces * parts)

        def move(x, heading):
            held = jnp.stack([jnp.asarray(frequency), heading])
            return task.truth.step(0.0, x, held, step), None

        return jax.lax.scan(move, task.start, jnp.repeat(unknown[:-1], parts))[0]

    def spare(unknown):
        return tolerance**2 - jnp.sum((end(unknown) - goal) ** 2)

    spare, slope = jax.jit(spare), jax.jit(jax.jacrev(spare))
    found = minimize(
        lambda u: u[-1],
        guess,
        jac=lambda u: np.eye(pieces + 1)[-1],
        constraints={"type": "ineq", "fun": spare, "jac": slope},
        method="SLSQP",
        options={"maxiter": 200, "ftol": 1e-9},
    )
    assert found.success
    return found.x[-1]


def test_the_vortex_cannot_be_crossed_more_quickly_by_a_direct_method():
    """A direct method that begins at the extremal finds nothing better near it."""
    task = tasks.task("vortex")
    found = zermelo.quickest_of_task(task)
    middles = found.headings[5::10]
    near = direct_time(task, np.append(middles, found.time))
    np.testing.assert_allclose(near, found.time, rtol=2e-3)
    end = found.xs[-1] + 0.3 * np.asarray(direction(jnp.asarray(found.headings[-1:])))
    assert isinstance(task.objective, ReachGoal)
    np.testing.assert_allclose(end, task.objective.goal, atol=1e-6)
    assert np.all(-task.arena.distance(jnp.asarray(found.xs.min(axis=0))) > 0)
    assert np.all(-task.arena.distance(jnp.asarray(found.xs.max(axis=0))) > 0)


def test_what_cannot_be_reached_is_said():
    with pytest.raises(FitError, match=r"no extremal reaches \[-3.0, 0.0\] within 9"):
        zermelo.quickest(
            lambda x: jnp.array([1.5, 0.0]),
            jnp.zeros(2),
            jnp.array([-3.0, 0.0]),
            speed=1.0,
            longest=9.0,
        )


def test_bad_numbers_are_refused():
    with pytest.raises(
        InputError, match=r"quickest: expected speed > 0, .* got 0.0, 9.0"
    ):
        zermelo.quickest(
            lambda x: x, jnp.zeros(2), jnp.zeros(2), speed=0.0, longest=9.0
        )


@pytest.mark.parametrize("name", ["barrier-weak", "follow-line", "y-junction"])
def test_other_tasks_have_no_extremals(name):
    with pytest.raises(InputError, match=f"task '{name}' has inertia, a path or zones"):
        zermelo.quickest_of_task(tasks.task(name))
