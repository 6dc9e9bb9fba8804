"""Tables of models: exact for low degrees, convergent, honest about what is not."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.navigation.steering_worlds import SwimmerPredictor, rolling
from tests.refusals import refusals

from pinav import forces
from pinav.actuation import LinearResponse
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.navigation import task
from pinav.navigation.predictors import (
    ControlMap,
    InertialTable,
    OverdampedTable,
    tabulate_model,
)
from pinav.navigation.tables import (
    FieldTable,
    Grid,
    force_spread,
    sample_times,
    tabulate,
    tabulate_over_time,
)
from pinav.navigation.task.steering import CommandLimits, RollingActuator
from pinav.navigation.task.task import Rectangle

REGION = Rectangle([0.0, -1.0], [4.0, 2.0])
ROLLING = RollingActuator(jnp.eye(2), LinearResponse())
STATIC = np.zeros(1)
BARRIER = forces.GaussianBarrier(2.0, [2.0, 0.5], 1.0)


NOTHING = forces.ZeroForce()


def inertial(environment=NOTHING, drag=None):
    drag = forces.LinearDrag(0.5) if drag is None else drag
    return rolling(Swimmer(NOTHING, drag, environment))


def carried(flow, environment=NOTHING):
    return rolling(OverdampedSwimmer(NOTHING, environment, 0.7, flow))


class Swinging(forces.AbstractFlow):
    def __call__(self, t, x):
        return jnp.sin(t) * x


def table_of(function, count=9):
    grid = Grid.over(REGION, count, margin=2)
    values = jax.vmap(jax.vmap(function))(grid.points)
    return FieldTable(grid, values[None])


def waves(x):
    return jnp.sin(2 * x) * jnp.cos(x[::-1])


def errors(function, places, counts, look_up):
    """The largest error of tables of some sizes."""
    exact = jax.vmap(function)(places)
    tables = [table_of(function, count) for count in counts]
    found = [jax.vmap(lambda x, t=t: look_up(t, 0.0, x))(places) for t in tables]
    return [float(jnp.abs(values - exact).max()) for values in found]


@pytest.fixture(scope="module")
def places():
    fractions = jax.random.uniform(jax.random.key(0), (40, 2))
    return REGION.lower[None] + fractions * (REGION.upper - REGION.lower)[None]


def test_linear_interpolation_is_exact_for_linear_fields_and_of_second_order(places):
    def linear(x):
        return jnp.stack([1.0 + 2.0 * x[0] - x[1], x[0] * x[1]])

    look_up = FieldTable.interpolate_linearly
    assert errors(linear, places, [9], look_up)[0] < 1e-11
    direction = jnp.array([[1.0], [0.5]])
    coarse, fine = errors(lambda x: jnp.sin(x @ direction), places, (17, 33), look_up)
    assert 2.5 < coarse / fine < 6.5


def quadratic(x):
    a, b = x
    return jnp.stack([1 + 2 * a - b + a * a * b, a * b - 3 * b * b + a * a * b * b])


@pytest.mark.slow
def test_a_table_is_exact_where_the_values_are_of_degree_two_along_each_axis(places):
    table = table_of(quadratic)
    found = jax.vmap(lambda x: table(0.0, x))(places)
    assert jnp.allclose(found, jax.vmap(quadratic)(places), atol=1e-12)
    slopes = jax.vmap(jax.jacfwd(lambda x: table(0.0, x)))(places)
    assert jnp.allclose(slopes, jax.vmap(jax.jacfwd(quadratic))(places), atol=1e-11)


def test_the_gradient_of_a_table_is_that_of_what_it_returns(places):
    table, x, step = table_of(waves, 6), places[7], 1e-6
    slope = jax.jacfwd(lambda x: table(0.0, x))(x)
    for axis, move in enumerate(step * jnp.eye(2)):
        change = (table(0.0, x + move) - table(0.0, x - move)) / (2 * step)
        assert jnp.allclose(change, slope[:, axis], atol=1e-8)


def test_the_error_falls_with_the_third_power_of_the_spacing(places):
    coarse, fine = errors(waves, places, (17, 33), FieldTable.__call__)
    assert fine < coarse / 6


def test_a_table_is_linear_in_time_and_constant_beyond_its_ends():
    grid = Grid.over(REGION, 5)
    values = jnp.arange(3.0)[:, None, None, None] * jnp.ones((3, *grid.shape, 1))
    table, x = FieldTable(grid, values, interval=0.5), jnp.array([1.3, 0.2])
    for t, value in ((0.2, 0.4), (0.9, 1.8), (-1.0, 0.0), (6.0, 2.0)):
        assert jnp.allclose(table(t, x), value)


def test_a_table_of_inertia_holds_force_and_drag(places):
    tensor = forces.UniaxialTensor(0.3, 0.8, forces.ConstantDirector(0.4))
    model = inertial(BARRIER, forces.TensorDrag(tensor))
    table = tabulate(model, Grid.over(REGION, 41, margin=2), STATIC)
    x = places[3]
    rates = table(0.0, x)
    assert jnp.allclose(rates[:2], BARRIER(0.0, x, jnp.zeros(2)), atol=1e-3)
    drag = jax.jacfwd(lambda v: tensor(x, v))(jnp.zeros(2))
    assert jnp.allclose(rates[2:].reshape(2, 2), drag, atol=1e-12)


PREDICTORS = {
    "inertial": (inertial(BARRIER), InertialTable, [1.2, 0.1, 0.4, -0.3]),
    "overdamped": (carried(forces.ShearFlow(0.4, 0.2)), OverdampedTable, [1.2, 0.1]),
}


@pytest.mark.parametrize(("model", "kind", "y"), PREDICTORS.values(), ids=PREDICTORS)
def test_a_step_on_the_table_is_of_second_order(model, kind, y):
    table = tabulate(model, Grid.over(REGION, 81, margin=2), STATIC)
    now = 0.0, jnp.array(y), jnp.array([0.6, 0.9])

    def error(h):
        exact = SwimmerPredictor(model).step(*now, h)
        return jnp.max(jnp.abs(kind(table, ROLLING).step(*now, h) - exact))

    assert error(0.4) < 6e-3
    assert error(0.2) < error(0.4) / 5 + 1e-6


def test_a_model_that_is_not_finite_is_refused_with_a_place():
    class Broken(forces.AbstractForce):
        def __call__(self, t, x, v):
            return jnp.where(x[0] > 3.9, jnp.nan, 0.0) * x

    with pytest.raises(InputError, match=r"model: expected a finite force .* as at"):
        tabulate(inertial(Broken()), Grid.over(REGION, 9), STATIC)


def test_times_are_many_only_where_the_model_changes():
    grid = Grid.over(REGION, 21)
    assert len(sample_times(inertial(BARRIER), grid, 9.0, 7)) == 1
    moving = inertial(forces.Moving(BARRIER, forces.LinearMotion([0.1, 0.0])))
    assert np.allclose(sample_times(moving, grid, 9.0, 7), np.linspace(0, 9, 7))


@pytest.mark.parametrize(
    "flow", [forces.ShearFlow(0.3, 0.5), Swinging()], ids=["steady", "swings"]
)
def test_a_flow_that_swings_is_all_that_is_evaluated_over_time(flow):
    model = carried(flow, BARRIER)
    grid = Grid.over(REGION, 11)
    moments = sample_times(model, grid, 9.0, 7)
    table = tabulate_over_time(model, grid, 9.0, 7)
    plain = tabulate(model, grid, moments)
    assert len(moments) == (7 if isinstance(flow, Swinging) else 1)
    assert jnp.allclose(table.first, plain.first, rtol=1e-12, atol=1e-14)
    for t in (0.0, 2.2, 8.9):
        x = jnp.array([1.3, 0.2])
        assert jnp.allclose(table(t, x), plain(t, x), rtol=1e-12, atol=1e-14)
    assert table.interval == plain.interval


def test_the_spread_of_no_samples_has_the_times_that_samples_would_have():
    model = carried(Swinging(), BARRIER)
    there = dataclasses.replace(task("shear"), truth=model, arena=REGION)
    tables = tabulate_model(there, model, points=9, times=7)
    assert len(tables.table.values) == 7
    assert tables.time_cost.spread.values.shape[0] == 1
    assert not tables.time_cost.spread.values.any()


def test_the_spread_of_two_models_is_that_of_two_numbers():
    pair = [inertial(forces.GaussianBarrier(h, [2.0, 0.5], 1.0)) for h in (1.0, 3.0)]
    grid = Grid.over(REGION, 9)
    spread = force_spread([tabulate(one, grid, STATIC) for one in pair])
    x = grid.points[3, 2]
    unit = jnp.linalg.norm(forces.GaussianBarrier(1.0, [2.0, 0.5], 1.0)(0.0, x, x))
    assert jnp.allclose(spread.values[0, 3, 2, 0], unit, rtol=1e-9)  # sqrt(2) / sqrt(2)


def test_a_drive_takes_the_frequency_of_the_greatest_thrust_and_turns_as_coils_do():
    still = jnp.zeros(2)
    drive = ControlMap.of(ROLLING, CommandLimits(0.8))
    assert drive.frequency == pytest.approx(0.8)
    command = drive.command(jnp.array([0.0, 0.5]), still, 0.1)
    assert jnp.allclose(command, jnp.array([0.4, jnp.pi / 2]))
    slope = jax.jacfwd(lambda w: drive.command(w, still, 0.1))(still)
    assert bool(jnp.all(jnp.isfinite(slope))), "without thrust"
    drive = ControlMap.of(ROLLING, CommandLimits(0.8, max_turning_rate=2.0))
    command = drive.command(jnp.array([0.0, 1.0]), still, 0.1)
    assert jnp.allclose(command, jnp.array([0.8, 0.2]))


IDLE = eqx.tree_at(lambda actuator: actuator.gain, ROLLING, jnp.zeros((2, 2)))
test_what_gives_no_table_or_drive_is_refused = refusals(
    (
        lambda: force_spread([tabulate(inertial(), Grid.over(REGION, 9), STATIC)]),
        "samples: expected 2 or more models, got 1",
    ),
    (lambda: Grid.over(REGION, 3), "Grid.over count: expected 4 or more, got 3"),
    (
        lambda: ControlMap.of(IDLE, CommandLimits(0.8)),
        "limits: expected a frequency that gives",
    ),
)
