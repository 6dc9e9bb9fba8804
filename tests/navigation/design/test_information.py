"""What a trajectory is expected to tell, against dense linear algebra."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav.dynamics import FixedStep, OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.fitting import Posterior, ravel_model
from pinav.forces import KernelPotential, LinearDrag, ZeroForce
from pinav.navigation.design.candidates import Experiment, begins, in_sequence
from pinav.navigation.design.information import (
    InformationGain,
    VarianceReduction,
    expected_posterior,
    inside,
    rank,
    suggest,
)
from pinav.navigation.design.prior import PriorField, prior_uncertainty
from pinav.navigation.task.steering import CommandLimits, HelicalActuator
from pinav.navigation.task.zones import Rectangle
from pinav.trajectories import Trajectories

pytestmark = pytest.mark.slow

ACTUATOR = HelicalActuator(gain=1.5, moment=1.0, amplitude=1.0, rotational_drag=0.16)
LIMITS = CommandLimits(max_frequency=1.0, max_turning_rate=1.2)
ARENA = Rectangle([-3.0, -3.0], [7.0, 7.0])
ROUTE = np.linspace([0.0, 0.0], [4.0, 4.0], 5)


def experiment(noise=0.02, states=4, duration=2.0, **others):
    region = Rectangle([0.0, 0.0], [1.0, 1.0])
    spread = np.full(states, noise)
    return Experiment(ACTUATOR, LIMITS, region, spread, duration, **others)


def kernels(seed=0):
    places = np.stack(np.meshgrid(np.arange(0.0, 5, 2), np.arange(0.0, 5, 2)), -1)
    weights = 0.3 * jax.random.normal(jax.random.key(seed), (9,))
    return KernelPotential(weights, jnp.asarray(places.reshape(-1, 2)), 1.5)


def posterior(model=None, seed=1):
    """A posterior with correlations, of a swimmer with inertia unless given."""
    if model is None:
        model = Swimmer(ZeroForce(), LinearDrag(0.36), kernels())
    free, theta = ravel_model(model, lambda m: m.environment.parameters)
    root = np.asarray(jax.random.normal(jax.random.key(seed), (9, 9))) * 0.2
    return Posterior(free, np.asarray(theta), root @ root.T + 0.01 * np.eye(9))


@eqx.filter_jit
def differences(known, candidate, design, points):
    """Slopes of all samples by parameters and start, by central differences."""

    def states(unknowns):
        model = known.free(unknowns[:9])
        model = eqx.tree_at(lambda m: m.propulsion, model, design.thrust(candidate))
        return FixedStep().solve(model, unknowns[9:], design.times)[0].ravel()

    unit = 1e-5 * jnp.eye(points.shape[0])
    up, down = (jax.vmap(states)(points[None] + sign * unit) for sign in (1.0, -1.0))
    return (up - down).T / 2e-5


@pytest.mark.parametrize("order", ["inertia", "overdamped"])
def test_the_expected_covariance_is_that_of_least_squares_with_a_free_start(order):
    model, states = Swimmer(ZeroForce(), LinearDrag(0.36), kernels()), 4
    if order == "overdamped":
        model, states = OverdampedSwimmer(ZeroForce(), kernels(), 1.0), 2
    known, design = posterior(model), experiment(states=states)
    candidate = design.draw(1, key=jax.random.key(2))[0]
    point = jnp.concatenate([jnp.asarray(known.mean), candidate.starts])
    jacobian = np.asarray(differences(known, candidate, design, point)) / 0.02
    normal = jacobian.T @ jacobian
    normal[:9, :9] += np.linalg.inv(known.covariance)
    expected = np.linalg.inv(normal)[:9, :9]
    found = expected_posterior(known, design, candidate)
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-5, atol=1e-8)
    np.testing.assert_array_equal(found.mean, known.mean)


def test_the_ranking_is_that_of_the_expected_posteriors():
    known, design = posterior(), experiment()
    candidates = design.draw(4, key=jax.random.key(3))
    found = rank(known, ROUTE, design, candidates, arena=ARENA)
    for index in range(2):
        after = expected_posterior(known, design, candidates[index]).force_sd(ROUTE)
        assert found.sd[index] == pytest.approx(np.sqrt(np.mean(after**2)), rel=1e-6)
    now = known.force_sd(ROUTE)
    assert found.sd_now == pytest.approx(np.sqrt(np.mean(now**2)), rel=1e-9)
    worth = found.sd_now**2 - found.sd**2
    np.testing.assert_allclose(found.worth, worth, rtol=1e-6)


def test_less_noise_tells_more():
    known, key = posterior(), jax.random.key(4)
    candidates = experiment().draw(4, key=key)
    clean, plain, noisy, blind = (
        rank(known, ROUTE, experiment(noise), candidates, arena=ARENA).worth
        for noise in (0.002, 0.02, 0.2, np.inf)
    )
    assert np.all((clean > plain) & (plain > noisy) & (noisy > 0))
    np.testing.assert_allclose(blind, 0.0, atol=1e-12)


def test_a_trajectory_far_away_tells_nothing():
    known, design = posterior(), experiment()
    candidate = design.draw(4, key=jax.random.key(5))
    away = eqx.tree_at(
        lambda s: s.starts, candidate, candidate.starts.at[:, :2].add(40.0)
    )
    everywhere = Rectangle([-90.0, -90.0], [90.0, 90.0])
    found = rank(known, ROUTE, design, away, arena=everywhere)
    np.testing.assert_allclose(found.worth, 0.0, atol=1e-12)


def test_information_is_the_gain_of_normal_distributions():
    before = np.diag([4.0, 9.0])
    after = np.array([[1.0, 0.0], [0.0, 9.0]])
    gain = InformationGain(1e-6)(jnp.asarray(before), jnp.asarray(after))
    assert float(gain) == pytest.approx(np.log(2.0))
    coarse = InformationGain(100.0)(jnp.asarray(before), jnp.asarray(after))
    assert float(coarse) == pytest.approx(1.5e-4, rel=0.01)
    fall = VarianceReduction()(jnp.asarray(before), jnp.asarray(after))
    assert float(fall) == pytest.approx(1.5)


def test_suggestions_only_improve_from_round_to_round():
    known, design = posterior(), experiment()
    options = {"arena": ARENA, "key": jax.random.key(6), "num_candidates": 4}
    worths = []
    for rounds in (1, 2, 3):
        found = suggest(known, ROUTE, design, rounds=rounds, **options)
        worths.append(found.worth[found.best])
    assert worths[1] >= worths[0]
    assert worths[2] >= worths[1]
    assert worths[2] > worths[0]


def test_the_worth_is_averaged_over_draws_of_the_model():
    known, design = posterior(), experiment()
    candidates = design.draw(4, key=jax.random.key(7))
    options = {"arena": ARENA, "key": jax.random.key(8)}
    mean = rank(known, ROUTE, design, candidates, arena=ARENA).worth
    several = rank(known, ROUTE, design, candidates, draws=2, **options).worth
    assert np.all(several != mean)
    certain = Posterior(known.free, known.mean, 1e-14 * known.covariance)
    few = rank(certain, ROUTE, design, candidates, draws=2, **options).worth
    same = rank(certain, ROUTE, design, candidates, arena=ARENA).worth
    np.testing.assert_allclose(few, same, rtol=1e-4)


def test_a_candidate_that_leaves_the_arena_is_not_suggested():
    known, design = posterior(), experiment()
    candidates = design.draw(4, key=jax.random.key(9))
    narrow = Rectangle([-0.1, -0.1], [1.2, 1.2])
    stays = np.asarray(inside(known.model, design, candidates, narrow))
    assert 0 < stays.sum() < 4
    found = rank(known, ROUTE, design, candidates, arena=narrow)
    np.testing.assert_array_equal(np.isfinite(found.worth), stays)
    assert stays[found.best]
    nowhere = rank(
        known, ROUTE, design, candidates, arena=Rectangle([50.0, 50.0], [51.0, 51.0])
    )
    with pytest.raises(InputError, match="each of the candidates leaves the arena"):
        _ = nowhere.best


def test_random_shots_obey_limits_and_region():
    design = experiment(turning=3.0)
    candidates = design.draw(50, key=jax.random.key(10))
    varied = design.vary(candidates[0], 50, key=jax.random.key(11))
    for made in (candidates, varied):
        assert np.all((made.frequency >= 0) & (made.frequency <= 1.0))
        assert np.all(np.abs(np.diff(made.heading)) <= 1.2 + 1e-12)
        assert np.all(made.starts[:, 2:] == 0)
        assert np.all((made.starts[:, :2] >= 0) & (made.starts[:, :2] <= 1))
    assert np.abs(np.diff(candidates.heading)).max() == pytest.approx(1.2)
    np.testing.assert_array_equal(
        varied.starts, np.tile(candidates.starts[:1], (50, 1))
    )


def test_each_shot_has_its_own_span_of_the_clock():
    design = experiment()
    candidates = design.draw(3, key=jax.random.key(12))
    together, at_rest = in_sequence(design, candidates), jnp.zeros(2)
    for index, begin in enumerate(begins(design, 3)):
        for t in (0.0, 0.7, 1.95):
            own = design.thrust(candidates[index])(t, at_rest, at_rest)
            found = together(begin + t, at_rest, at_rest)
            np.testing.assert_allclose(found, own, atol=1e-12)


def test_bad_input_is_refused():
    known, design = posterior(), experiment()
    candidates = design.draw(1, key=jax.random.key(13))
    with pytest.raises(InputError, match="Experiment.duration: expected > 0"):
        experiment(duration=0.0)
    with pytest.raises(InputError, match=r"Experiment\.noise: expected numbers > 0"):
        experiment(noise=0.0)
    with pytest.raises(InputError, match="InformationGain.resolution: expected > 0"):
        InformationGain(0.0)
    with pytest.raises(InputError, match="route: expected points in the plane"):
        rank(known, np.zeros(3), design, candidates, arena=ARENA)
    with pytest.raises(InputError, match="2 draws need key"):
        rank(known, ROUTE, design, candidates, arena=ARENA, draws=2)
    with pytest.raises(InputError, match="1 or more rounds and candidates"):
        suggest(known, ROUTE, design, arena=ARENA, key=jax.random.key(0), rounds=0)


def recorded(design, model, count=2):
    """Noisy observations of a few candidates, and the swimmer as a fit knows it."""
    candidates = design.draw(count, key=jax.random.key(20))
    propulsion = in_sequence(design, candidates)
    driven = eqx.tree_at(lambda m: m.propulsion, model, propulsion)
    times = [np.asarray(design.times) + begin for begin in begins(design, count)]
    states = [
        FixedStep().solve(driven, candidates.starts[i], jnp.asarray(ts))[0]
        for i, ts in enumerate(times)
    ]
    data = Trajectories.from_arrays(
        times, [np.asarray(s) for s in states], channels=("x", "y", "vx", "vy")
    )
    return driven, data, jnp.stack(states)


def test_doubt_is_the_prior_far_from_the_data_and_little_near_them():
    design = experiment()
    model, data, states = recorded(design, posterior().model)
    wide = Rectangle([-8.0, -8.0], [12.0, 12.0])
    prior = PriorField(wide, strength=0.7, length=3.0)
    posterior_force = prior_uncertainty(model, data, states, noise=0.002, prior=prior)
    far, near = (
        posterior_force.force_sd(np.array([[10.0, -6.0]])),
        posterior_force.force_sd(states[0, 10:11, :2]),
    )
    assert np.sqrt(np.mean(far**2)) == pytest.approx(0.7, rel=0.1)
    assert np.all(near < 0.1)
    mean = posterior_force.model.environment(0.0, states[0, 5, :2], jnp.zeros(2))
    fitted = model.environment(0.0, states[0, 5, :2], jnp.zeros(2))
    np.testing.assert_allclose(mean, fitted, rtol=1e-12)


def test_doubt_vanishes_as_the_noise_does_and_returns_with_it():
    design = experiment()
    model, data, states = recorded(design, posterior().model)
    options = {"prior": PriorField(ARENA, strength=0.7)}
    sizes = [
        np.mean(
            prior_uncertainty(model, data, states, noise=s, **options).force_sd(ROUTE)
            ** 2
        )
        for s in (1e-3, 1e-1, 1e4)
    ]
    assert sizes[0] < sizes[1] < sizes[2]
    kernels = options["prior"].kernels()
    free, theta = ravel_model(
        model.with_environment(kernels),
        lambda m: m.environment.parameters,
    )
    variance = options["prior"].amplitude(kernels) ** 2 * np.eye(len(theta))
    prior = Posterior(free, np.asarray(theta), variance).force_sd(ROUTE)
    assert sizes[2] == pytest.approx(np.mean(prior**2), rel=1e-4)
    with pytest.raises(InputError, match="prior_uncertainty noise: expected > 0"):
        prior_uncertainty(model, data, states, noise=0.0, **options)
    with pytest.raises(InputError, match=r"PriorField\.strength: expected > 0"):
        PriorField(ARENA, strength=0.0)
