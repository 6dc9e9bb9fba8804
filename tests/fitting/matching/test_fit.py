from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.fitting.problems import follow, observing

from pinav import fitting
from pinav.actuation import RotatingField
from pinav.dynamics import RK4, FixedStep, Swimmer
from pinav.errors import FitError, InputError
from pinav.fitting.matching.fit import _FitTask
from pinav.fitting.matching.state import Observations
from pinav.forces import (
    GaussianBarrier,
    LinearDrag,
    MagneticPropulsion,
    NeuralForce,
    PositionFeatures,
    tanh_network,
)
from pinav.trajectories import Trajectories

pytestmark = pytest.mark.slow

BARRIER = GaussianBarrier(height=2.0, center=[1.0, 0.2], width=0.8)
TRUTH = Swimmer(
    MagneticPropulsion(RotatingField(1.0, 2.0), [0.0, 0.0, 1.0], 0.3, [0.0, 1.0]),
    LinearDrag(0.5),
    BARRIER,
)
OBJECTIVE = fitting.TrajectoryLoss(FixedStep(RK4))


def observe(starts, lengths) -> Trajectories:
    return follow(TRUTH, starts, [np.linspace(0.0, 0.1 * (n - 1), n) for n in lengths])


@pytest.fixture(scope="module")
def data() -> Trajectories:
    return observe([[-1.0, 0.0, 1.5, 0.1], [0.0, -1.0, 0.5, 1.0]], [25, 20])


def network_swimmer(seed: int) -> Swimmer:
    network = tanh_network(2, 2, width=8, depth=1, key=jax.random.key(seed))
    environment = NeuralForce(network, PositionFeatures((0.0, 0.0), (1.0, 1.0)))
    return TRUTH.with_environment(environment)


def environment(model):
    return model.environment


def test_phases_to_come_are_compiled_once_for_each_program(data, monkeypatch):
    """Phases that differ in a window share a program; the first one has its own."""
    compiled, take_steps = [], _FitTask.take_steps

    def note(self, state, count):
        if count == 0:
            compiled.append(state.phase)
        return take_steps(self, state, count)

    monkeypatch.setattr(_FitTask, "take_steps", note)
    windows = [fitting.GaussNewton(window, target=1e-9, steps=1) for window in (1, 5)]
    steps = [
        fitting.Adam(learning_rate=1e-3, steps=2),
        fitting.Adam(learning_rate=1e-3, steps=2),
    ]
    result = fitting.fit(
        network_swimmer(0), data, [*windows, *steps], trainable=environment
    )
    assert compiled == [2]
    assert [start for _, start in result.phases] == [0, 1, 2, 4]


RECIPE = (fitting.Adam(1e-2, 300), fitting.LBFGS(40))
ASKED = {"trainable": environment, "objective": OBJECTIVE}
EXACTLY = ASKED | {"dtype": jnp.float64}


@pytest.fixture(scope="module")
def fitted(data):
    return fitting.fit(network_swimmer(0), data, RECIPE, **ASKED)


def test_a_network_learns_the_force(fitted, data):
    assert fitted.outcome is fitting.Outcome.COMPLETED
    assert fitted.losses[-1] < 1e-3 * fitted.losses[0]
    final = OBJECTIVE(fitted.model, Observations.of(data, jnp.float32))
    assert final == pytest.approx(fitted.losses[-1], rel=1e-5)
    assert fitted.phases == (("Adam", 0), ("L-BFGS", 300))


def test_only_the_selected_leaves_change(fitted):
    before, after = fitted.initial_model, fitted.model
    assert eqx.tree_equal(before.drag, after.drag)
    assert eqx.tree_equal(before.propulsion, after.propulsion)
    assert not eqx.tree_equal(before.environment, after.environment)
    assert after.environment.network.layers[0].weight.dtype == jnp.float32


def test_the_same_seed_gives_the_same_numbers_and_progress_covers_every_step_once(
    fitted, data
):
    seen = []
    again = fitting.fit(network_swimmer(0), data, RECIPE, **ASKED, on_chunk=seen.append)
    np.testing.assert_array_equal(again.losses, fitted.losses)
    assert eqx.tree_equal(again.model, fitted.model)
    assert sum(p.losses.shape[1] for p in seen) == 340
    assert [p.done for p in seen] == [250, 300, 325, 340]
    assert {p.total for p in seen} == {340}
    assert [p.phase for p in seen] == ["Adam", "Adam", "L-BFGS", "L-BFGS"]


class Halving(fitting.AbstractPhase):
    """Halves all parameters until they are small; says each time that it did."""

    heard: Callable[[], None] = eqx.field(static=True, default=print)
    side_by_side: bool = eqx.field(static=True, default=False)
    name: str = eqx.field(static=True, default="halving")
    num_steps: int = eqx.field(static=True, default=30)
    chunk_steps: int = eqx.field(static=True, default=10)

    def init(self, loss, params, value):
        return jnp.zeros((), bool)

    def step(self, loss, params, state):
        def halved():
            jax.debug.callback(self.heard)
            return jax.tree.map(lambda leaf: 0.5 * leaf, params)

        params = jax.lax.cond(state, lambda: params, halved)
        size = sum(jnp.sum(leaf**2) for leaf in jax.tree.leaves(params))
        return params, size < 1e-6, jnp.zeros((), size.dtype)

    def is_done(self, state):
        return state

    def outcome(self, state):
        return jnp.zeros((), int)


def halvings(models, data, **options):
    """How often the fits of several models took a step in all."""
    heard = []
    recipe = (Halving(heard=lambda: heard.append(1), **options),)
    fitting.fit_many(models, data, recipe, **ASKED)
    jax.effects_barrier()
    return len(heard)


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="about fits on a CPU")
def test_a_fit_that_is_done_takes_no_steps_while_others_do(data):
    large = network_swimmer(0)
    weights = jax.tree.map(
        lambda leaf: 1e-3 * leaf if eqx.is_array(leaf) else leaf, large.environment
    )
    small = large.with_environment(weights)
    few = halvings([small, small], data, side_by_side=False)
    many = halvings([large, large], data, side_by_side=False)
    assert 0 < few < many - 10
    both = halvings([large, small], data, side_by_side=False)
    assert 2 * both == few + many
    assert halvings([large, small], data, side_by_side=True) > both


def test_gauss_newton_fits_of_many_are_the_single_fits(data):
    models = [network_swimmer(seed) for seed in range(2)]
    recipe = fitting.curriculum(data, max_steps=4)
    together = fitting.fit_many(models, data, recipe, at_once=2, **EXACTLY)
    in_turns = fitting.fit_many(models, data, recipe, **EXACTLY)
    for one, other in zip(together, in_turns, strict=True):
        np.testing.assert_allclose(other.losses[-1], one.losses[-1], rtol=1e-3)


@pytest.mark.parametrize("at_once", [None, 1, 2])
def test_many_fits_are_the_single_fits_each_with_data_of_its_own(data, at_once):
    models = [network_swimmer(seed) for seed in range(3)]
    other = observe([[0.5, 0.0, 0.3, 0.8], [0.0, 1.0, 0.5, 0.1]], [15, 22])
    own, recipe = [data, other, data], (fitting.Adam(1e-2, 20),)
    many = fitting.fit_many(models, own, recipe, at_once=at_once, **EXACTLY)
    for model, mine, found in zip(models, own, many, strict=True):
        alone = fitting.fit(model, mine, recipe, **EXACTLY)
        np.testing.assert_allclose(found.losses, alone.losses, rtol=1e-7)
    assert len({float(one.losses[-1]) for one in many}) == 3


def test_gauss_newton_runs_in_float32_and_on_resamples(data):
    models = [network_swimmer(seed) for seed in range(2)]
    draws = [data.select([0, 0]), data.select([1, 0])]
    recipe = fitting.curriculum(data, max_steps=6)
    for found in fitting.fit_many(models, draws, recipe, dtype=jnp.float32, **ASKED):
        assert found.model.environment.network.layers[0].weight.dtype == jnp.float32
        assert found.losses[-1] < 1e-4 * found.losses[0]


def test_damping_and_gain_can_be_learned_with_the_barrier_known(data):
    def constants(swimmer):
        return swimmer.drag.damping, swimmer.propulsion.gain

    start = eqx.tree_at(constants, TRUTH, (0.2, 0.1))
    objective = fitting.TrajectoryLoss()
    found = fitting.fit(
        start,
        data,
        (fitting.LBFGS(40),),
        trainable=constants,
        objective=objective,
        dtype=jnp.float64,
    )
    assert constants(found.model) == pytest.approx((0.5, 0.3), rel=1e-5)


def test_what_was_not_observed_does_not_count(data):
    masked = data.observed.copy()
    masked[:, 5:9, 2:] = False
    loss, everything = (
        OBJECTIVE(TRUTH, Observations.of(seen, jnp.float64))
        for seen in (observing(data, masked), data)
    )
    assert loss < 1e-7
    assert loss < everything


class Memory(fitting.AbstractCheckpoint):
    """Keeps states, and may break off like a killed process."""

    def __init__(self, stop_after=None):
        self.states, self.stop_after = [], stop_after

    def load(self, like):
        if not self.states:
            return None
        saved = self.states[-1]
        shape = like(saved.phase)
        assert jax.tree.structure(shape.params) == jax.tree.structure(saved.params)
        return saved

    def save(self, state: fitting.FitState):
        self.states.append(state)
        if self.stop_after and len(self.states) == self.stop_after:
            raise KeyboardInterrupt


@pytest.mark.parametrize("chunks", [1, 2, 3])
def test_an_interrupted_fit_goes_on_to_the_same_numbers(fitted, data, chunks):
    call = ASKED | {"checkpoint": Memory(stop_after=chunks)}
    with pytest.raises(KeyboardInterrupt):
        fitting.fit(network_swimmer(0), data, RECIPE, **call)
    resumed = fitting.fit(network_swimmer(0), data, RECIPE, **call)
    np.testing.assert_array_equal(resumed.losses, fitted.losses)
    assert eqx.tree_equal(resumed.model, fitted.model)


def test_a_diverging_fit_says_so(data):
    wild = (fitting.Adam(1e30, 5),)
    with pytest.raises(FitError, match="the fit diverged: its loss is not finite; use"):
        fitting.fit(network_swimmer(0), data, wild, **ASKED)
    result = fitting.fit(network_swimmer(0), data, wild, throw=False, **ASKED)
    assert result.outcome is fitting.Outcome.DIVERGED


def test_bad_requests_are_refused(data):
    models = [network_swimmer(0), network_swimmer(1)]
    with pytest.raises(InputError, match="expected at least one model and one phase"):
        fitting.fit(models[0], data, (), **ASKED)
    nothing = {"trainable": lambda s: s.environment.network.activation}
    with pytest.raises(InputError, match="the selection holds no floating-point array"):
        fitting.fit(models[0], data, RECIPE, **nothing)
    late = data.observed.copy()
    late[1, 0, 2] = False
    with pytest.raises(InputError, match="trajectory 1: its first sample must be full"):
        fitting.fit(models[0], observing(data, late), RECIPE, **ASKED)
    with pytest.raises(InputError, match="at_once: expected 1 or more, got 0"):
        fitting.fit_many(models, data, RECIPE, at_once=0, **ASKED)
    with pytest.raises(InputError, match="one for each of the 2 models, got 3"):
        fitting.fit_many(models, [data] * 3, RECIPE, **ASKED)
    with pytest.raises(InputError, match="as many trajectories and channels"):
        fitting.fit_many(models, [data, data.select([0])], RECIPE, **ASKED)
