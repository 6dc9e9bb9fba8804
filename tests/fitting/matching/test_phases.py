import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import rosen
from tests.refusals import refusals

from pinav.fitting import LBFGS, Adam, paper_recipe

PHASES = {
    "adam": lambda steps: Adam(learning_rate=1e-2, steps=steps),
    "lbfgs": lambda steps: LBFGS(steps=steps),
}


def rosenbrock(x):
    return jnp.sum(100.0 * (x[1:] - x[:-1] ** 2) ** 2 + (1 - x[:-1]) ** 2)


def minimise(phase, loss, params):
    """Run a phase as `fit` does, and record the loss before each step."""

    @jax.jit
    def everything(params):
        def body(carry, _):
            *carry, value = phase.step(loss, *carry)
            return tuple(carry), value

        carry = (params, phase.init(loss, params, loss(params)))
        (params, _), values = jax.lax.scan(body, carry, length=phase.num_steps)
        return params, values

    return everything(params)


@pytest.mark.parametrize("make", PHASES.values(), ids=PHASES)
def test_every_phase_lowers_a_convex_loss(make):
    scales = jnp.array([1.0, 10.0, 0.1])
    x, values = minimise(
        make(300), lambda x: jnp.sum(scales * (x - 1) ** 2), 0.0 * scales
    )
    assert values[0] == pytest.approx(11.1)
    assert jnp.sum(scales * (x - 1) ** 2) < 0.2


@pytest.mark.parametrize("make", PHASES.values(), ids=PHASES)
def test_every_phase_reports_the_loss_before_each_step(make):
    start = jnp.array([-1.2, 1.0])
    _, values = minimise(make(3), rosenbrock, start)
    assert values[0] == pytest.approx(rosen(np.asarray(start)))
    assert values[-1] < values[0]


@pytest.mark.parametrize("make", PHASES.values(), ids=PHASES)
def test_every_phase_batches_to_the_same_numbers(make):
    starts = jnp.array([[-1.2, 1.0], [0.5, -0.3]])
    one = jnp.stack([minimise(make(10), rosenbrock, start)[0] for start in starts])
    batched = jax.vmap(lambda start: minimise(make(10), rosenbrock, start)[0])(starts)
    np.testing.assert_allclose(batched, one, rtol=1e-9)


def test_lbfgs_solves_rosenbrock_in_ten_dimensions():
    x, values = minimise(LBFGS(steps=120), rosenbrock, jnp.full(10, -1.0))
    np.testing.assert_allclose(x, 1.0, atol=1e-6)
    assert jnp.all(jnp.diff(values) <= 0), "a line search never goes up"


def test_lbfgs_survives_a_loss_that_is_infinite_beyond_a_wall():
    def walled(x):
        return jnp.where(jnp.abs(x[0]) < 1.5, jnp.sum((x - 1.4) ** 2), jnp.inf)

    x, _ = minimise(LBFGS(steps=30), walled, jnp.array([-1.0, 3.0]))
    assert walled(x) < walled(jnp.array([-1.0, 3.0]))


def test_paper_recipe_is_table_1():
    adam, lbfgs = paper_recipe()
    assert (adam.name, adam.num_steps, adam.learning_rate) == ("Adam", 7500, 0.01)
    assert (lbfgs.name, lbfgs.num_steps) == ("L-BFGS", 500)
    assert eqx.tree_equal(paper_recipe(3, 4), (Adam(0.01, 3), LBFGS(4)))


test_bad_phases_are_refused = refusals(
    (lambda: Adam(0.0, 5), r"Adam.learning_rate: expected > 0, got 0.0"),
    (lambda: Adam(0.1, 0), r"Adam.steps: expected > 0, got 0"),
    (lambda: LBFGS(-1), r"LBFGS.steps: expected > 0, got -1"),
    (lambda: LBFGS(5, memory=0), r"LBFGS.memory: expected > 0, got 0"),
)
