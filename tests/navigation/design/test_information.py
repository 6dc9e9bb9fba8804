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
from pinav.navigation.design.candidates import Experiment, best_candidate
from pinav.navigation.design.information import (
    PosteriorInformation,
    PriorField,
    prior_uncertainty,
)
from pinav.navigation.task.steering import CommandLimits, HelicalActuator
from pinav.navigation.task.task import Rectangle
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


def judge(known, design, arena=ARENA, way=ROUTE):
    return PosteriorInformation.of(known, way, design, arena)


@pytest.mark.parametrize("order", ["inertia", "overdamped"])
def test_what_is_expected_is_that_of_least_squares_with_a_free_start(order):
    model, states = Swimmer(ZeroForce(), LinearDrag(0.36), kernels()), 4
    if order == "overdamped":
        model, states = OverdampedSwimmer(ZeroForce(), kernels(), 1.0), 2
    known, design = posterior(model), experiment(states=states)
    candidate = design.draw(1, key=jax.random.key(2))[0]
    point = jnp.concatenate([jnp.asarray(known.mean), candidate.starts])
    jacobian = np.asarray(differences(known, candidate, design, point)) / 0.02
    normal = jacobian.T @ jacobian
    normal[:9, :9] += np.linalg.inv(known.covariance)
    covariance = np.linalg.inv(normal)[:9, :9]
    expected = Posterior(known.free, known.mean, covariance).force_sd(ROUTE)
    found = judge(known, design)
    rms = np.sqrt(np.mean(expected**2))
    assert found(candidate) == pytest.approx(rms, rel=1e-5)
    now = known.force_sd(ROUTE)
    assert found.sd_now == pytest.approx(np.sqrt(np.mean(now**2)), rel=1e-9)


def test_less_noise_tells_more():
    known = posterior()
    drawn = experiment().draw(2, key=jax.random.key(4))
    for candidate in (drawn[0], drawn[1]):
        clean, plain, noisy, blind = (
            judge(known, experiment(noise))(candidate)
            for noise in (0.002, 0.02, 0.2, np.inf)
        )
        assert clean < plain < noisy < blind
        assert blind == pytest.approx(judge(known, experiment()).sd_now, rel=1e-12)


def test_a_trajectory_far_away_tells_nothing():
    known, design = posterior(), experiment()
    candidate = design.draw(1, key=jax.random.key(5))[0]
    away = eqx.tree_at(lambda s: s.starts, candidate, candidate.starts.at[:2].add(40.0))
    found = judge(known, design, Rectangle([-90.0, -90.0], [90.0, 90.0]))
    assert found(away) == pytest.approx(found.sd_now, rel=1e-12)


def test_a_search_only_improves_from_round_to_round():
    known, design = posterior(), experiment()
    first = design.draw(4, key=jax.random.key(6))
    keys, found = jax.random.split(jax.random.key(16), 2), judge(known, design)
    sds = [
        best_candidate(found, design, first, variations=3, keys=keys[:rounds])[1]
        for rounds in (0, 1, 2)
    ]
    assert sds[0] == min(found(first[k]) for k in range(4))
    assert sds[0] >= sds[1] >= sds[2]
    assert sds[0] > sds[2]


def test_a_candidate_that_leaves_the_arena_is_not_chosen():
    known, design = posterior(), experiment()
    candidates = design.draw(4, key=jax.random.key(9))
    narrow = Rectangle([-0.1, -0.1], [1.2, 1.2])
    stays = []
    for k in range(4):
        thrust = design.thrust(candidates[k])
        driven = eqx.tree_at(lambda m: m.propulsion, known.model, thrust)
        states, _ = FixedStep().solve(driven, candidates[k].starts, design.times)
        stays.append(bool(np.all((states[:, :2] >= -0.1) & (states[:, :2] <= 1.2))))
    assert 0 < sum(stays) < 4
    found = judge(known, design, narrow)
    assert [np.isfinite(found(candidates[k])) for k in range(4)] == stays
    best, sd = best_candidate(found, design, candidates, variations=1, keys=())
    assert np.isfinite(sd)
    nowhere = judge(known, design, Rectangle([50.0, 50.0], [51.0, 51.0]))
    _, sd = best_candidate(nowhere, design, candidates, variations=1, keys=())
    assert sd == np.inf


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


def test_bad_input_is_refused():
    known, design = posterior(), experiment()
    with pytest.raises(InputError, match="Experiment.duration: expected > 0"):
        experiment(duration=0.0)
    with pytest.raises(InputError, match=r"Experiment\.noise: expected numbers > 0"):
        experiment(noise=0.0)
    with pytest.raises(InputError, match="route: expected points in the plane"):
        judge(known, design, way=np.zeros(3))


def recorded(design, model):
    """Noisy observations of a candidate, and the swimmer as a fit knows it."""
    candidate = design.draw(1, key=jax.random.key(20))[0]
    driven = eqx.tree_at(lambda m: m.propulsion, model, design.thrust(candidate))
    states, _ = FixedStep().solve(driven, candidate.starts, design.times)
    data = Trajectories.from_arrays(
        [np.asarray(design.times)],
        [np.asarray(states)],
        channels=("x", "y", "vx", "vy"),
    )
    return driven, data, states[None]


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
