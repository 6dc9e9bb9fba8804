import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.fitting.problems import beginning, follow

from pinav.dynamics import FixedStep, NeuralDynamics, Swimmer
from pinav.evaluation import exact_forces, predict, score
from pinav.evaluation.force_fields import field_map, force_errors
from pinav.fitting import Rates, TrajectoryLoss, defect_recipe, fit, rates_to_match
from pinav.fitting.environments.catalogue import build
from pinav.fitting.environments.gradient_matching import (
    match_kernels,
    prior_root,
    simpler_models,
)
from pinav.fitting.environments.rates import (
    force_region,
    forces_beside_drag,
    observed_rates,
    residual_forces,
)
from pinav.fitting.environments.summary import (
    ModelChoice,
    learned_part,
    summarise_for_matching,
)
from pinav.forces import (
    ConstantForce,
    GaussianBarrier,
    KernelForce,
    KernelPotential,
    LinearDrag,
    gaussian_swirl,
    tanh_network,
)
from pinav.scenarios import scenario
from pinav.trajectories import Trajectories, simulate

BARRIER = GaussianBarrier(3.0, [2.0, 0.3], 0.8)
TRUTH = Swimmer(ConstantForce([0.0, 0.05]), LinearDrag(0.3), BARRIER)


def observe(truth: Swimmer, count: int = 2) -> Trajectories:
    starts = [[-1.0, 0.4 * i, 2.2 - 0.3 * i, 0.1] for i in range(count)]
    return follow(truth, starts, [np.arange(0.0, 8.0, 0.1)] * count)


def rates_of(data):
    rates = observed_rates(data)
    assert rates is not None
    return rates


def total(model, data):
    return score(*predict(model, data), data).total


@pytest.fixture(scope="module")
def data():
    return observe(TRUTH)


def test_splines_give_the_rates_of_exact_states(data):
    rates = rates_of(data)
    true = jax.vmap(TRUTH)(jnp.asarray(rates.times), jnp.asarray(rates.states))
    inside = (rates.times > 0.5) & (rates.times < 7.0)
    np.testing.assert_allclose(rates.rates[inside], true[inside], atol=1e-3)


def test_matched_kernels_explain_the_data_without_a_rollout(data):
    environment = match_kernels(TRUTH, rates_of(data))
    assert isinstance(environment, KernelPotential)
    assert total(TRUTH.with_environment(environment), data) < 5e-3


def test_a_force_without_potential_is_told_from_one_with():
    truth = TRUTH.with_environment(gaussian_swirl(3.0, [2.0, 0.3], 1.5))
    seen = observe(truth, count=4)
    environment = match_kernels(truth, rates_of(seen))
    assert isinstance(environment, KernelForce)


def test_kernels_stay_where_the_force_acts():
    narrow = TRUTH.with_environment(GaussianBarrier(3.0, [2.0, 0.3], 0.3))
    rates = rates_of(observe(narrow))
    sizes = np.linalg.norm(residual_forces(narrow, rates), axis=1)
    acting = rates.states[sizes >= 1e-7 * sizes.max(), :2]
    assert len(acting) < len(sizes)
    environment = match_kernels(narrow, rates)
    gaps = np.asarray(environment.centers)[:, None] - acting
    assert np.linalg.norm(gaps, axis=2).min(axis=1).max() < 4 * environment.width


def test_too_few_samples_give_no_rates(data):
    short = beginning(data, 5)
    assert observed_rates(short) is None
    assert rates_to_match(TRUTH, short) is None
    assert simpler_models(TRUTH, short) == {}


def test_a_black_box_is_asked_for_the_same_rates_beside_the_path(data):
    network = tanh_network(5, 4, width=4, depth=1, key=jax.random.key(0))
    box = NeuralDynamics(network, (0.0,) * 5, (1.0,) * 5)
    targets = rates_to_match(box, data)
    assert targets is not None
    half = len(targets.times) // 2
    np.testing.assert_array_equal(targets.rates[:half], targets.rates[half:])
    assert simpler_models(box, data) == {}
    for nothing_to_learn in (box, TRUTH):
        assert prior_root(nothing_to_learn, data) is None


def test_physics_alone_is_among_the_simpler_models(data):
    errors = {name: total(m, data) for name, m in simpler_models(TRUTH, data).items()}
    assert errors["a kernel field"] < 0.01 * errors["the known physics"]


def test_the_region_of_a_force_is_where_it_acts(data):
    rates = rates_of(data)
    region = force_region(rates, residual_forces(TRUTH.without_environment(), rates))
    assert region is not None
    positions = data.states[..., :2].reshape(-1, 2)
    weights = np.linalg.norm(exact_forces(BARRIER, positions), axis=1)
    weights /= weights.sum()
    center = weights @ positions
    np.testing.assert_allclose(region.center, center, atol=0.02)
    radius = np.sqrt((weights @ (positions - center) ** 2).mean())
    assert region.radius == pytest.approx(radius, rel=0.05)
    assert region.radius < 0.7 * np.sqrt(positions.var(axis=0).mean())


def test_no_force_has_no_region():
    free, times = TRUTH.without_environment(), np.arange(9.0)
    states = np.random.default_rng(0).normal(size=(9, 4))
    rates = jax.vmap(free)(jnp.asarray(times), jnp.asarray(states))
    none = Rates(times, states, np.asarray(rates))
    assert force_region(none, residual_forces(free, none)) is None


def test_drag_and_thrust_are_told_from_a_force_that_acts_in_few_places():
    """Without any known physics the force is left, and the least squares bend it."""
    rng = np.random.default_rng(1)
    states, times = rng.uniform(-1.0, 1.0, size=(200, 4)), np.arange(200.0)
    drag, thrust = np.array([[-0.4, 0.1], [0.0, -0.7]]), np.array([0.1, -0.3])
    forces = np.zeros((200, 2))
    forces[states[:, 0] > 0.8] = [30.0, -10.0]
    motion = states[:, 2:] @ drag.T + thrust
    without = forces_beside_drag(states[:9, 2:], motion[:9])
    np.testing.assert_allclose(without, 0.0, atol=1e-12)
    rates = Rates(times, states, np.concatenate([states[:, 2:], motion + forces], 1))
    left = forces_beside_drag(states[:, 2:], motion + forces)
    np.testing.assert_allclose(left, forces, atol=0.05)
    region = force_region(rates, left)
    assert region is not None
    assert region.center[0] == pytest.approx(0.9, abs=0.05)


@pytest.mark.slow
def test_exact_data_leave_the_force_beside_the_path_to_a_smooth_prior():
    paper, choice = scenario("paper"), ModelChoice("kernel-potential")
    data, swimmer = simulate(paper), paper.swimmer
    untrained = build(choice, swimmer, summarise_for_matching(choice, swimmer, data))
    recipe = defect_recipe(data, prior_root=prior_root(untrained, data))
    fitted = fit(
        untrained,
        data,
        recipe,
        trainable=learned_part,
        objective=TrajectoryLoss(FixedStep(substeps=2)),
        dtype=np.float64,
    )
    assert total(fitted.model, data) < 1e-5
    learned = field_map(fitted.model.environment, data)
    errors = force_errors(learned, field_map(paper.environment, data))
    assert errors["visited"] < 1e-3
    assert errors["near"] < 3e-3
