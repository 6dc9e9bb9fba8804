import functools

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from benchmarks.continuous_adjoint import InterpolatingAdjoint
from jax.flatten_util import ravel_pytree
from scipy.integrate import solve_ivp
from tests.refusals import refusals

from pinav.actuation import RotatingField
from pinav.dynamics import (
    RK4,
    TSIT5,
    Adaptive,
    FixedStep,
    ForwardOnly,
    Outcome,
    OverdampedSwimmer,
    Swimmer,
    linear_recursion,
    rollout,
)
from pinav.forces import (
    GaussianBarrier,
    LinearDrag,
    MagneticPropulsion,
    NeuralForce,
    PositionTimeFeatures,
    ScheduledThrust,
    ZeroForce,
    tanh_network,
)
from pinav.scenarios import paper

TIMES = jnp.array([0.0, 0.1, 0.25, 0.5, 0.6, 0.6, 0.6])
"""Irregular, and padded at the end as in `Trajectories`."""


def learner():
    """A swimmer with a small network, a traced damping, and its start."""
    features = PositionTimeFeatures(center=(0.5, 0.5, 0.0), scale=(1.0, 2.0, 1.0))
    network = tanh_network(3, 2, width=3, depth=1, key=jax.random.key(1))
    force = NeuralForce(network, features)
    model = Swimmer(ZeroForce(), LinearDrag(jnp.array(0.4)), force)
    return model, jnp.array([0.2, -0.1, 1.0, 0.5])


def loss_of(solver, refine=1):
    """A loss of the flat vector of weights, damping and start; and that vector.

    `refine` puts that many intervals in place of each between two samples.
    """
    index = jnp.arange(refine * (len(TIMES) - 1) + 1) / refine
    ts = jnp.interp(index, jnp.arange(float(len(TIMES))), TIMES)
    arrays, static = eqx.partition(learner(), eqx.is_inexact_array)
    vector, unravel = ravel_pytree(arrays)
    data = 0.1 * jnp.arange(4.0 * len(TIMES)).reshape(-1, 4)

    def loss(vector):
        model, y0 = eqx.combine(unravel(vector), static)
        ys = rollout(model, y0, ts, solver=solver, throw=False).ys
        return jnp.sum((ys[::refine] - data) ** 2)

    return loss, vector


def central_differences(loss, vector, step):
    steps = step * jnp.eye(len(vector))
    around = vector[None] + jnp.concatenate([steps, -steps])
    above, below = jnp.split(jax.jit(jax.vmap(loss))(around), 2)
    return (above - below) / (2 * step)


def assert_relative(actual, expected, tolerance):
    scale = float(jnp.max(jnp.abs(expected)))
    np.testing.assert_allclose(actual, expected, rtol=0, atol=tolerance * scale)


FIXED = {"Tsit5": FixedStep(), "RK4, two substeps": FixedStep(RK4, substeps=2)}
TIGHT = {
    "recursive": Adaptive(),
    "direct": Adaptive(adjoint=diffrax.DirectAdjoint(), max_steps=64),
    "backsolve": Adaptive(adjoint=diffrax.BacksolveAdjoint()),
    "interpolating": InterpolatingAdjoint(1e-10, 1e-10, diffrax.Dopri8()),
}


@pytest.mark.parametrize("solver", FIXED.values(), ids=list(FIXED))
def test_fixed_step_gradient_equals_differences(solver):
    loss, vector = loss_of(solver)
    expected = central_differences(loss, vector, 1e-5)
    assert_relative(jax.jit(jax.grad(loss))(vector), expected, 1e-6)


@pytest.fixture(scope="module")
def true_gradient():
    """Differences of the solution itself, by a solver whose error is below 1e-11."""
    return central_differences(*loss_of(FixedStep(), refine=20), 1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("solver", TIGHT.values(), ids=list(TIGHT))
def test_adjoints_give_the_gradient_of_the_solution(solver, true_gradient):
    loss, vector = loss_of(solver)
    assert_relative(jax.jit(jax.grad(loss))(vector), true_gradient, 1e-6)


def plain_scan(solver, model, y0, ts):
    """`FixedStep.solve` without its arrangement of the gradient."""

    def advance(y, interval):
        y = solver.step(model, y, *interval)
        return y, y

    _, later = jax.lax.scan(advance, y0, (ts[:-1], ts[1:]))
    return jnp.concatenate([y0[None], later])


@pytest.mark.parametrize("substeps", [1, 2])
def test_a_looped_step_is_the_step(substeps):
    solver = FixedStep(substeps=substeps)

    def field(t, y):
        return jnp.stack([y[1], -jnp.sin(y[0]) + jnp.cos(3.0 * t)])

    inputs = field, jnp.array([0.3, -1.2]), 0.7, 0.9
    np.testing.assert_allclose(
        solver.looped_step(*inputs), solver.step(*inputs), rtol=1e-14
    )


@pytest.mark.slow
def test_fixed_step_derivatives_of_both_modes_equal_those_of_a_plain_scan():
    """States of three starts, of one vector of parameters and a start."""
    solver = FixedStep(substeps=2)
    arrays, static = eqx.partition(learner(), eqx.is_inexact_array)
    vector, unravel = ravel_pytree(arrays)

    def states(solve, vector):
        model, y0 = eqx.combine(unravel(vector), static)
        starts = y0[None] * jnp.arange(1.0, 4.0)[:, None]
        return jax.vmap(lambda y0: solve(model, y0, TIMES))(starts)

    arranged = functools.partial(states, lambda *inputs: solver.solve(*inputs)[0])
    plain = functools.partial(states, functools.partial(plain_scan, solver))
    expected, pull_plain = jax.vjp(plain, vector)
    actual, pull = jax.vjp(arranged, vector)
    cotangent = jnp.cos(jnp.arange(expected.size)).reshape(expected.shape)
    np.testing.assert_allclose(actual, expected, atol=1e-14)
    assert_relative(pull(cotangent)[0], pull_plain(cotangent)[0], 1e-12)
    tangent = jnp.sin(jnp.arange(float(len(vector))))
    pushed, wanted = (
        jax.jvp(both, (vector,), (tangent,))[1] for both in (arranged, plain)
    )
    assert_relative(pushed, wanted, 1e-12)


def test_linear_recursion_equals_a_loop():
    rng = np.random.default_rng(0)
    start, matrices, sources = (
        rng.normal(size=shape) for shape in ((3,), (6, 3, 3), (6, 3))
    )
    expected = [start]
    for matrix, source in zip(matrices, sources, strict=True):
        expected.append(matrix @ expected[-1] + source)
    actual = linear_recursion(*map(jnp.asarray, (start, matrices, sources)))
    np.testing.assert_allclose(actual, expected, rtol=1e-13)


def paper_slope(t, y):
    """The paper's system in plain NumPy, written anew from its equations."""
    x, v = y[:2], y[2:]
    offset = x - 5.0
    barrier = 5.25 / 2.9**2 * np.exp(-offset @ offset / (2 * 2.9**2)) * offset
    return np.concatenate([v, [0.0, 0.034] - 0.36 * v + barrier])


@pytest.mark.parametrize(
    ("tableau", "lowest", "highest"),
    [(TSIT5, 4.8, 6.0), (RK4, 3.8, 4.5)],
    ids=["Tsit5", "RK4"],
)
def test_fixed_step_converges_at_its_order(tableau, lowest, highest):
    scenario = paper()
    start, precisely = scenario.starts[0], {"rtol": 1e-13, "atol": 1e-14}
    true = solve_ivp(paper_slope, (0, 8), start, "DOP853", **precisely).y[:, -1]

    @jax.jit
    def error(ts):
        last = FixedStep(tableau).solve(scenario.truth, start, ts)[0][-1]
        return jnp.linalg.norm(last - true)

    coarse, fine = (jnp.linspace(0.0, 8.0, steps + 1) for steps in (40, 80))
    ratio = error(jnp.pad(coarse, (0, 40), "edge")) / error(fine)
    assert lowest <= np.log2(ratio) <= highest


def test_adaptive_solver_conserves_energy_on_the_barrier():
    barrier = GaussianBarrier(height=5.25, center=[5.0, 5.0], width=2.9)
    swimmer = Swimmer(ZeroForce(), LinearDrag(0.0), barrier)
    start, ts = jnp.array([0.0, 0.0, 1.6, 1.4]), jnp.linspace(0.0, 12.0, 61)
    ys = eqx.filter_jit(rollout)(swimmer, start, ts).ys
    kinetic = 0.5 * jnp.sum(ys[:, 2:] ** 2, axis=1)
    energy = kinetic + jax.vmap(lambda x: barrier.potential(0.0, x))(ys[:, :2])
    assert jnp.min(kinetic) < 0.5 * jnp.max(kinetic), "the barrier must matter"
    np.testing.assert_allclose(energy, energy[0], rtol=0, atol=1e-8)


def test_constant_thrust_against_drag_follows_the_closed_form():
    field = RotatingField(amplitude=2.0, frequency=5.0)
    thrust = MagneticPropulsion(field, [0.0, 0.0, 1.0], gain=0.4, axis=[0.6, 0.8])
    swimmer = Swimmer(thrust, LinearDrag(0.7), ZeroForce())
    start, times = jnp.array([1.0, -2.0, 3.0, 1.0]), jnp.linspace(0.0, 9.0, 10)
    run = eqx.filter_jit(rollout)(swimmer, start, times)
    (x0, v0), ts = np.split(start, 2), np.asarray(times)[:, None]
    terminal, decay = 0.8 * np.array([0.6, 0.8]) / 0.7, np.exp(-0.7 * ts)
    v = terminal[None] + (v0 - terminal)[None] * decay
    x = x0[None] + terminal[None] * ts + (v0 - terminal)[None] * (1 - decay) / 0.7
    np.testing.assert_allclose(run.ys, np.hstack([x, v]), rtol=0, atol=1e-8)
    np.testing.assert_array_equal(run.ts, times)
    assert run.outcome == Outcome.SUCCESS


@pytest.mark.parametrize(
    "solver",
    [FixedStep(), Adaptive(), ForwardOnly()],
    ids=["fixed", "adaptive", "forward only"],
)
def test_repeated_times_repeat_the_state(solver):
    ys = eqx.filter_jit(rollout)(*learner(), TIMES, solver=solver).ys
    np.testing.assert_array_equal(ys[-3], ys[-2])
    np.testing.assert_array_equal(ys[-3], ys[-1])


test_bad_arguments_are_named = refusals(
    (lambda: FixedStep(substeps=0), r"FixedStep.substeps: expected >= 1, got 0"),
    (lambda: Adaptive(rtol=0.0), r"Adaptive.rtol: expected > 0, got 0.0"),
    (lambda: Adaptive(atol=-1.0), r"Adaptive.atol: expected > 0, got -1.0"),
    (
        lambda: InterpolatingAdjoint(rtol=float("nan")),
        r"InterpolatingAdjoint.rtol: expected > 0, got nan",
    ),
)


@pytest.mark.slow
def test_forward_only_takes_the_steps_of_adaptive_across_jumps_of_the_thrust():
    asked = jnp.array([[1.0, 0.0], [0.0, 2.0], [0.0, 0.0]])
    thrust = ScheduledThrust(jnp.array([0.0, 0.3, 0.7]), asked, 0 * asked, 0.1, 0.2)
    barrier = GaussianBarrier(height=2.0, center=[0.5, 0.5], width=0.4)
    swimmer = Swimmer(thrust, LinearDrag(0.7), barrier)
    y0, ts = jnp.array([0.1, 0.2, 1.0, 0.3]), jnp.linspace(0.0, 2.0, 9)
    solve = eqx.filter_jit(rollout)
    expected = solve(swimmer, y0, ts, solver=Adaptive())
    run = solve(swimmer, y0, ts, solver=ForwardOnly())
    np.testing.assert_allclose(run.ys, expected.ys, rtol=0, atol=1e-10)
    assert run.outcome == expected.outcome


@pytest.mark.parametrize("tableau", [TSIT5, RK4], ids=["tsit5", "rk4"])
def test_a_thrust_that_jumps_at_samples_is_followed_exactly(tableau):
    """Each step sees the thrust between its ends, whichever way the times round."""
    asked = jnp.tile(jnp.cos(jnp.arange(20.0))[:, None], (1, 3))
    thrust = ScheduledThrust(jnp.arange(20.0) * 0.1, asked, asked, 0.0, 0.0)
    swimmer = OverdampedSwimmer(thrust, ZeroForce(), 1.0)
    ts = jnp.linspace(0.0, 2.0, 21)  # differs from its times in the last digit
    run = rollout(swimmer, jnp.zeros(3), ts, solver=FixedStep(tableau))
    expected = jnp.concatenate([jnp.zeros(1), 0.1 * jnp.cumsum(asked[:, 0])])
    np.testing.assert_allclose(run.ys[:, 1], expected, rtol=0, atol=1e-12)
