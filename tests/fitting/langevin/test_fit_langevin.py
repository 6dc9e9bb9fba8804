"""Stochastic paths: force and diffusion; and quantities derived from a posterior."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav.dynamics import BrownianSwimmer, OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.fitting import (
    Posterior,
    derive,
    fit_langevin,
    kernel_environment,
    model_evidence,
    principal_drags,
    ravel_model,
    rotational_fraction,
)
from pinav.fitting.langevin import Increments
from pinav.forces import (
    CholeskyTensor,
    ConstantDirector,
    HarmonicTrap,
    KernelMixture,
    KernelPotential,
    KernelStream,
    LinearDrag,
    TensorDrag,
    UniaxialTensor,
    ZeroForce,
    tensor_matrix,
)
from pinav.trajectories import Trajectories

STIFFNESS, MOBILITY, DIFFUSION = 1.5, 0.8, 0.3
RNG = np.random.default_rng(0)


def trapped(count=6, samples=300):
    """Exact paths in a harmonic trap (Ornstein and Uhlenbeck), at irregular times."""
    rate = MOBILITY * STIFFNESS
    times = [np.cumsum(RNG.uniform(0.02, 0.06, samples)) for _ in range(count)]
    states = []
    for own in times:
        x = [RNG.normal(size=2) * np.sqrt(DIFFUSION / rate)]
        for interval in np.diff(own):
            decay = np.exp(-rate * interval)
            spread = np.sqrt(DIFFUSION / rate * (1 - decay**2))
            x.append(decay * x[-1] + spread * RNG.normal(size=2))
        states.append(np.array(x))
    observed = [np.ones((samples, 2), bool) for _ in range(count)]
    observed[0][5:8] = False
    return Trajectories.from_arrays(
        times, states, channels=("x", "y"), observed=observed
    )


DATA = trapped()


def swimmer(environment):
    return OverdampedSwimmer(ZeroForce(), environment, MOBILITY)


@pytest.fixture(scope="module")
def fitted():
    environment = kernel_environment(KernelPotential, DATA, dim=2)
    return fit_langevin(BrownianSwimmer(swimmer(environment), 0.1), DATA)


def test_increments_span_gaps_and_stay_within_a_trajectory():
    increments = Increments.of(DATA)
    assert len(increments.times) == 6 * 299 - 3
    first = DATA.trajectory(0)
    np.testing.assert_allclose(increments.intervals[4], first.times[8] - first.times[4])
    total = increments.steps[:296].sum(axis=0)
    np.testing.assert_allclose(total, first.states[-1] - first.states[0])


def test_diffusion_is_within_its_interval(fitted):
    found = fitted.constants["diffusion"]
    assert abs(found.value - DIFFUSION) < 3 * found.sd + 0.05 * DIFFUSION
    expected = DIFFUSION * np.sqrt(2 / (2 * 6 * 299))
    assert found.sd == pytest.approx(expected, rel=0.1)


def test_the_force_of_the_trap_is_within_its_band(fitted):
    points = np.array([[0.3, 0.0], [0.0, -0.4], [0.2, 0.3], [-0.3, 0.1]])
    trap = HarmonicTrap(STIFFNESS, [0.0, 0.0])

    def forces(force):
        at = jax.vmap(lambda x: force(0.0, x, jnp.zeros(2)))
        return np.asarray(at(jnp.asarray(points)))

    miss = forces(fitted.model.environment) - forces(trap)
    assert np.all(np.abs(miss) < 4 * fitted.posterior.force_sd(points))
    assert np.linalg.norm(miss) < 0.5 * np.linalg.norm(forces(trap))


@pytest.mark.slow
def test_known_diffusion_is_kept_and_has_the_evidence_of_its_density(fitted):
    model = swimmer(kernel_environment(KernelPotential, DATA, dim=2))
    known = fit_langevin(model, DATA, diffusion=0.31)
    diffusion = known.constants["diffusion"]
    assert (diffusion.value, diffusion.sd) == (0.31, 0.0)
    evidence = model_evidence(known.linear, known.hyperparameters)
    assert 0 <= evidence.correction < 30
    free = model_evidence(fitted.linear, fitted.hyperparameters)
    assert free.best > evidence.best


def test_what_it_cannot_fit_is_refused():
    good = swimmer(kernel_environment(KernelPotential, DATA, dim=2))
    inert = Swimmer(ZeroForce(), LinearDrag(1.0), ZeroForce())
    with pytest.raises(InputError, match="without inertia, got Swimmer; .* fit_bayes"):
        fit_langevin(inert, DATA)
    with pytest.raises(InputError, match="made by kernel_environment, got ZeroForce"):
        fit_langevin(swimmer(ZeroForce()), DATA)
    with pytest.raises(InputError, match="diffusion: expected a finite number > 0"):
        fit_langevin(good, DATA, diffusion=0.0)
    wide = Trajectories.from_arrays([0.0, 1.0], np.eye(2, 3), channels=("x", "y", "z"))
    with pytest.raises(InputError, match="expected 2 channels, positions alone"):
        fit_langevin(good, wide)
    single = Trajectories.from_arrays(
        [0.0, 1.0],
        np.zeros((2, 2)),
        channels=("x", "y"),
        observed=np.array([[True, True], [True, False]]),
    )
    with pytest.raises(InputError, match="two or more samples with all positions"):
        fit_langevin(good, single)


def posterior_of(model, select, spread):
    free, theta = ravel_model(model, select)
    return Posterior(free, np.asarray(theta), spread**2 * np.eye(len(theta)))


def drags(along, across, angle, spread=1e-3):
    truth = UniaxialTensor(along, across, ConstantDirector(angle))
    tensor = CholeskyTensor.of(tensor_matrix(truth, jnp.zeros(2)))
    model = Swimmer(ZeroForce(), TensorDrag(tensor), ZeroForce())
    return posterior_of(model, lambda m: m.drag.tensor, spread)


@pytest.mark.parametrize("angle", [-1.2, -0.3, 0.5, 1.4])
def test_principal_drags_are_those_that_were_put_in(angle):
    found = principal_drags(drags(0.24, 0.48, angle))
    values = [found[name].value for name in ("along", "across", "director")]
    np.testing.assert_allclose(values, [0.24, 0.48, angle], rtol=1e-10)


def test_their_deviations_are_those_of_samples():
    posterior = drags(0.24, 0.48, 0.5)
    found = principal_drags(posterior)
    draws = []
    for model in posterior.samples(300, key=jax.random.key(0)):
        lower = np.asarray(model.drag.tensor.lower())
        values, vectors = np.linalg.eigh(lower @ lower.T)
        angle = np.arctan2(vectors[1, 0], vectors[0, 0])
        draws.append([*values, (angle + np.pi / 2) % np.pi - np.pi / 2])
    expected = np.std(draws, axis=0)
    sds = [found[name].sd for name in ("along", "across", "director")]
    np.testing.assert_allclose(sds, expected, rtol=0.2)


def test_an_isotropic_drag_has_no_director():
    model = Swimmer(
        ZeroForce(), TensorDrag(CholeskyTensor.of(0.36 * jnp.eye(2))), ZeroForce()
    )
    found = principal_drags(posterior_of(model, lambda m: m.drag.tensor, 0.01))
    assert found["director"].sd == np.inf
    assert found["along"].value == pytest.approx(0.36)
    plain = Swimmer(ZeroForce(), LinearDrag(1.0), ZeroForce())
    with pytest.raises(InputError, match="expected a planar TensorDrag .* LinearDrag"):
        principal_drags(posterior_of(plain, lambda m: m.drag.damping, 0.1))


def test_the_rotational_fraction_of_equal_parts_is_a_half():
    centers, weights = jnp.zeros((1, 2)), jnp.array([1.0])
    mixture = KernelMixture(
        KernelPotential(weights, centers, 1.0), KernelStream(weights, centers, 1.0)
    )
    model = swimmer(mixture)
    posterior = posterior_of(model, lambda m: m.environment.parameters, 0.01)
    points = RNG.normal(size=(20, 2))
    found = rotational_fraction(posterior, points)
    assert found.value == pytest.approx(0.5)
    assert found.sd == pytest.approx(0.5 * 0.01 * np.sqrt(2), rel=1e-6)
    with pytest.raises(InputError, match="KernelMixture and one or more points"):
        rotational_fraction(posterior, points[:0])


def test_the_delta_method_is_exact_for_a_linear_quantity():
    model = swimmer(HarmonicTrap(1.0, [2.0, 0.0]))
    free, theta = ravel_model(model, lambda m: m.environment.center)
    covariance = np.array([[2.0, 0.5], [0.5, 1.0]])
    (found,) = derive(
        Posterior(free, np.asarray(theta), covariance),
        lambda m: m.environment.center[:1] - 3 * m.environment.center[1:],
    )
    assert found.value == pytest.approx(2.0)
    assert found.sd**2 == pytest.approx(2.0 - 2 * 3 * 0.5 + 9.0)
