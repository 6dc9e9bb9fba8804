import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from tests.fitting.problems import follow, observing

from pinav import fitting
from pinav.dynamics import (
    Adaptive,
    FixedStep,
    NeuralDynamics,
    OverdampedSwimmer,
    Swimmer,
)
from pinav.errors import InputError
from pinav.fitting.matching.damped_steps import low_rank
from pinav.fitting.matching.fit import run_chunk
from pinav.fitting.matching.state import split_trainable
from pinav.fitting.matching.windows import Windows
from pinav.forces import (
    GaussianBarrier,
    HarmonicTrap,
    KernelPotential,
    LinearDrag,
    NeuralForce,
    PositionTimeFeatures,
    ZeroForce,
    tanh_network,
)
from pinav.trajectories import Trajectories

KEY = jax.random.key(0)
TRUTH = Swimmer(ZeroForce(), LinearDrag(0.5), GaussianBarrier(2.0, [1.0, 0.2], 0.8))


FIRST_ORDER = OverdampedSwimmer(
    HarmonicTrap(0.6, [1.0, 0.0]), GaussianBarrier(0.8, [0.1, 0.1], 0.7), 0.9
)
"""Without inertia; the trap is known, so that mobility and height can be told apart."""


def observe(*lengths, irregular=False, truth=TRUTH) -> Trajectories:
    rng, size = np.random.default_rng(3), 4 if truth is TRUTH else 2
    times, starts = [], []
    for length in lengths:
        steps = rng.uniform(0.05, 0.15, length) if irregular else np.full(length, 0.1)
        times.append(np.cumsum(steps) - steps[0])
        starts.append([-1.0, rng.normal(0.0, 0.3), 1.5, 0.1][:size])
    return follow(truth, starts, times)


def with_gaps(data: Trajectories) -> Trajectories:
    """The same without some samples, and some components of others."""
    observed = data.observed.copy()
    observed[:, 5:8] = False
    observed[:, 10, observed.shape[2] // 2 :] = False
    return observing(data, observed)


def network_swimmer(truth=TRUTH) -> Swimmer | OverdampedSwimmer:
    features = PositionTimeFeatures((0.0, 0.0, 1.0), (1.0, 1.0, 1.0))
    force = NeuralForce(tanh_network(3, 2, width=4, depth=1, key=KEY), features)
    return truth.with_environment(force)


def black_box() -> NeuralDynamics:
    network = tanh_network(5, 4, width=4, depth=1, key=KEY)
    return NeuralDynamics(network, (0.0,) * 5, (1.0,) * 5)


def network(model):
    return model.environment.parameters


MODELS = {
    "network": (network_swimmer, network),
    "network and damping": (network_swimmer, lambda m: (network(m), m.drag.damping)),
    "black box": (black_box, lambda m: m.parameters),
    "barrier": (lambda: TRUTH, lambda m: (m.environment, m.drag.damping)),
    "network of first order": (lambda: network_swimmer(FIRST_ORDER), network),
    "barrier and mobility": (
        lambda: FIRST_ORDER,
        lambda m: (m.environment, m.mobility.value),
    ),
}


def windows(data, name, window):
    make, trainable = MODELS[name]
    params, static = split_trainable(make(), trainable, jnp.float64)
    observations = fitting.Observations.of(data, jnp.float64)
    problem = fitting.Problem(static, observations, fitting.TrajectoryLoss(FixedStep()))
    inputs = jnp.asarray(window), FixedStep()
    return Windows.of(problem, params, *inputs), ravel_pytree(params)[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "window"),
    [
        ("network", 1),
        ("network and damping", 100),
        ("black box", 4),
        ("barrier", 4),
        ("network of first order", 4),
        ("barrier and mobility", 100),
    ],
)
def test_the_jacobian_is_that_of_the_residuals(name, window):
    model = MODELS[name][0]()
    truth = FIRST_ORDER if isinstance(model, OverdampedSwimmer) else TRUTH
    data = with_gaps(observe(14, 18, irregular=True, truth=truth))
    problem, theta = windows(data, name, window)

    @jax.jit
    def both(theta):
        starts, residual, surrogate = problem.surrogate(theta)
        exact = jax.jacrev(lambda theta: problem.surrogate(theta)[1])(theta)
        return problem.jacobian(theta, starts), exact, residual, surrogate(theta)

    ours, exact, residual, nearby = both(theta)
    scale = np.abs(exact).max()
    np.testing.assert_allclose(ours, exact, atol=1e-9 * scale, rtol=1e-9)
    np.testing.assert_allclose(nearby, residual, atol=1e-13)


def test_a_restart_waits_for_a_complete_sample():
    data = with_gaps(observe(14))
    problem, _ = windows(data, "network", 5)
    # Samples 5 and 10 are incomplete, so only the first one restarts.
    assert np.flatnonzero(problem.restart[0]).tolist() == [0]
    problem, _ = windows(data, "network", 4)
    assert np.flatnonzero(problem.restart[0]).tolist() == [0, 4, 8, 12]


def test_the_projection_holds_a_matrix_of_low_rank():
    rng = np.random.default_rng(0)
    matrix = jnp.asarray(rng.normal(size=(200, 20)) @ rng.normal(size=(20, 150)))
    left, scale, right = low_rank(matrix, 40)
    np.testing.assert_allclose((left * scale[None]) @ right.T, matrix, atol=1e-6)
    kept = right[:, :20]  # the rest are directions that the matrix does not have
    np.testing.assert_allclose(kept.T @ kept, np.eye(20), atol=1e-8)
    small = matrix[:, :10]
    left, scale, right = low_rank(small, 40)
    np.testing.assert_allclose((left * scale[None]) @ right.T, small, atol=1e-10)


def kernel_swimmer(data: Trajectories) -> Swimmer:
    force = fitting.kernel_environment(
        KernelPotential, data, fitting.KernelGrid(10, 1.5, 2.0)
    )
    return TRUTH.with_environment(force)


STEPS = fitting.TrajectoryLoss(FixedStep())


def learn(
    model, data, recipe, trainable=lambda m: m.environment.parameters, objective=STEPS
):
    return fitting.fit(
        model, data, recipe, trainable=trainable, objective=objective, dtype=jnp.float64
    )


@pytest.fixture(scope="module")
def data():
    return observe(31, 26)


@pytest.mark.slow
def test_the_curriculum_fits_kernels_and_compiles_once(data):
    compiled = run_chunk._cached._cache_size()
    found = learn(kernel_swimmer(data), data, fitting.curriculum(data))
    assert found.losses[-1] < 1e-8 * found.losses[0]
    assert len(found.losses) - 1 <= 20
    assert [name for name, _ in found.phases] == ["L = 1", "L = 5", "L = 25", "L = 30"]
    assert run_chunk._cached._cache_size() == compiled + 1


@pytest.mark.slow
def test_barrier_and_damping_are_found_exactly(data):
    start = eqx.tree_at(
        lambda s: (s.environment.height, s.drag.damping), TRUTH, (1.0, 0.2)
    )
    recipe, finer = (
        fitting.curriculum(data, precision=1e-9),
        fitting.TrajectoryLoss(FixedStep(substeps=4)),
    )
    found = learn(start, data, recipe, MODELS["barrier"][1], finer)
    assert found.outcome is fitting.Outcome.CONVERGED
    found = found.model
    assert found.environment.height == pytest.approx(2.0, rel=1e-7)
    np.testing.assert_allclose(found.environment.center, [1.0, 0.2], rtol=1e-6)
    assert found.drag.damping == pytest.approx(0.5, rel=1e-7)


@pytest.mark.slow
def test_the_default_recipe_finds_barrier_and_mobility_without_inertia():
    data = with_gaps(observe(30, 30, 30, irregular=True, truth=FIRST_ORDER))
    wrong = OverdampedSwimmer(
        FIRST_ORDER.propulsion, GaussianBarrier(0.5, [0.0, 0.2], 0.8), 1.1
    )
    learned, finer = (
        MODELS["barrier and mobility"][1],
        fitting.TrajectoryLoss(FixedStep(substeps=2)),
    )
    result = learn(wrong, data, fitting.curriculum(data), learned, finer)
    found, true = (ravel_pytree(learned(m))[0] for m in (result.model, FIRST_ORDER))
    np.testing.assert_allclose(found, true, rtol=1e-5)


def test_a_phase_that_is_done_stays_where_it_is(data):
    reached = fitting.GaussNewton(window=jnp.asarray(30), target=1e9, steps=5)
    found = learn(kernel_swimmer(data), data, (reached,))
    assert len(found.losses) == 2, "one step, then it saw that the target is met"


@pytest.mark.slow
def test_a_stalled_phase_ends(data):
    phase = fitting.GaussNewton(window=jnp.asarray(1), target=0.0, steps=50)
    found = learn(kernel_swimmer(data), data, (phase,))
    assert len(found.losses) < 40


def test_windows_follow_the_longest_trajectory(data):
    steps = [int(phase.window) for phase in fitting.curriculum(data)]
    assert steps == [1, 5, 25, 30]
    assert [int(phase.window) for phase in fitting.curriculum(observe(6))] == [1, 5]


def test_bad_requests_are_refused(data):
    with pytest.raises(InputError, match="GaussNewton.rank: expected > 0, got 0"):
        fitting.GaussNewton(window=jnp.asarray(1), target=0.0, rank=0)
    with pytest.raises(InputError, match="GaussNewton.steps: expected > 0, got 0"):
        fitting.curriculum(data, max_steps=0)
    with pytest.raises(InputError, match="RateMatching.steps: expected > 0, got 0"):
        fitting.RateMatching(
            fitting.Rates(np.zeros(1), np.zeros((1, 4)), np.zeros((1, 2))), 0
        )
    freely, recipe = fitting.TrajectoryLoss(Adaptive()), fitting.curriculum(data)
    with pytest.raises(InputError, match="expected an objective with a FixedStep"):
        learn(kernel_swimmer(data), data, recipe, objective=freely)


@pytest.mark.slow
def test_outcomes_tell_stalled_from_a_misfit(data):
    full = jnp.asarray(10**6)
    few = (fitting.GaussNewton(full, target=1e-12, steps=1),)
    assert learn(kernel_swimmer(data), data, few).outcome is fitting.Outcome.STALLED
    # a constant that cannot explain the barrier: the best one is reached
    patient = (fitting.GaussNewton(full, target=1e-9, patience=jnp.asarray(3)),)
    known = TRUTH.without_environment()
    drag = learn(known, data, patient, lambda m: m.drag.damping)
    assert drag.losses[-1] > 1e-3
    assert drag.outcome is fitting.Outcome.MISFIT, "nothing more to gain, but no noise"
