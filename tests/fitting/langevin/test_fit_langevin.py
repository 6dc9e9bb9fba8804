"""Stochastic paths: force and diffusion; and quantities derived from a posterior."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.fitting.problems import beginning, in_a_trap, observing

from pinav import fitting
from pinav.dynamics import BrownianSwimmer, OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.evaluation import exact_forces
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
    """Paths in a harmonic trap at irregular times, of which the first has a gap."""
    times = [np.cumsum(RNG.uniform(0.02, 0.06, samples)) for _ in range(count)]
    rate = MOBILITY * STIFFNESS
    states = [in_a_trap(RNG, own, 2, rate, DIFFUSION) for own in times]
    data = Trajectories.from_arrays(times, states, channels=("x", "y"))
    observed = data.observed.copy()
    observed[0, 5:8] = False
    return observing(data, observed)


DATA = trapped()


def swimmer(environment):
    return OverdampedSwimmer(ZeroForce(), environment, MOBILITY)


@pytest.fixture(scope="module")
def untrained():
    return swimmer(fitting.kernel_environment(KernelPotential, DATA, dim=2))


@pytest.fixture(scope="module")
def fitted(untrained):
    return fitting.fit_langevin(BrownianSwimmer(untrained, 0.1), DATA)


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
    true = -STIFFNESS * points
    miss = exact_forces(fitted.model.environment, points) - true
    assert np.all(np.abs(miss) < 4 * fitted.posterior.force_sd(points))
    assert np.linalg.norm(miss) < 0.5 * np.linalg.norm(true)


@pytest.mark.slow
def test_known_diffusion_is_kept_and_has_the_evidence_of_its_density(fitted, untrained):
    known = fitting.fit_langevin(untrained, DATA, diffusion=0.31)
    diffusion = known.constants["diffusion"]
    assert (diffusion.value, diffusion.sd) == (0.31, 0.0)
    evidence = fitting.model_evidence(known.linear, known.hyperparameters)
    assert 0 <= evidence.correction < 30
    free = fitting.model_evidence(fitted.linear, fitted.hyperparameters)
    assert free.best > evidence.best


def test_what_it_cannot_fit_is_refused(untrained):
    inert = Swimmer(ZeroForce(), LinearDrag(1.0), ZeroForce())
    with pytest.raises(InputError, match="without inertia, got Swimmer; .* fit_bayes"):
        fitting.fit_langevin(inert, DATA)
    with pytest.raises(InputError, match="made by kernel_environment, got ZeroForce"):
        fitting.fit_langevin(swimmer(ZeroForce()), DATA)
    with pytest.raises(InputError, match="diffusion: expected a finite number > 0"):
        fitting.fit_langevin(untrained, DATA, diffusion=0.0)
    wide = Trajectories.from_arrays([0.0, 1.0], np.eye(2, 3), channels=("x", "y", "z"))
    with pytest.raises(InputError, match="expected 2 channels, positions alone"):
        fitting.fit_langevin(untrained, wide)
    half = observing(beginning(DATA, 2), np.array([[[True, True], [True, False]]]))
    with pytest.raises(InputError, match="two or more samples with all positions"):
        fitting.fit_langevin(untrained, half)


def posterior_of(model, select, covariance):
    """About a model, with a covariance or one standard deviation of all numbers."""
    free, theta = fitting.ravel_model(model, select)
    if np.ndim(covariance) == 0:
        covariance = covariance**2 * np.eye(len(theta))
    return fitting.Posterior(free, np.asarray(theta), covariance)


PARTS = ("along", "across", "director")


def drags(tensor, spread=1e-3):
    model = Swimmer(ZeroForce(), TensorDrag(CholeskyTensor.of(tensor)), ZeroForce())
    return posterior_of(model, lambda m: m.drag.tensor, spread)


def turned(angle):
    """Drags of 0.24 along a direction and 0.48 across."""
    tensor = UniaxialTensor(0.24, 0.48, ConstantDirector(angle))
    return drags(tensor_matrix(tensor, jnp.zeros(2)))


@pytest.mark.parametrize("angle", [-1.2, -0.3, 0.5, 1.4])
def test_principal_drags_are_those_that_were_put_in(angle):
    found = fitting.principal_drags(turned(angle))
    values = [found[name].value for name in PARTS]
    np.testing.assert_allclose(values, [0.24, 0.48, angle], rtol=1e-10)


def test_their_deviations_are_those_of_samples():
    posterior, draws = turned(0.5), []
    for model in posterior.samples(300, key=jax.random.key(0)):
        lower = np.asarray(model.drag.tensor.lower())
        values, vectors = np.linalg.eigh(lower @ lower.T)
        angle = np.arctan2(vectors[1, 0], vectors[0, 0])
        draws.append([*values, (angle + np.pi / 2) % np.pi - np.pi / 2])
    found = fitting.principal_drags(posterior)
    sds = [found[name].sd for name in PARTS]
    np.testing.assert_allclose(sds, np.std(draws, axis=0), rtol=0.2)


def test_an_isotropic_drag_has_no_director():
    found = fitting.principal_drags(drags(0.36 * jnp.eye(2), 0.01))
    assert found["director"].sd == np.inf
    assert found["along"].value == pytest.approx(0.36)
    plain = Swimmer(ZeroForce(), LinearDrag(1.0), ZeroForce())
    with pytest.raises(InputError, match="expected a planar TensorDrag .* LinearDrag"):
        fitting.principal_drags(posterior_of(plain, lambda m: m.drag.damping, 0.1))


def test_the_rotational_fraction_of_equal_parts_is_a_half():
    kernel = jnp.array([1.0]), jnp.zeros((1, 2)), 1.0
    model = swimmer(KernelMixture(KernelPotential(*kernel), KernelStream(*kernel)))
    posterior = posterior_of(model, lambda m: m.environment.parameters, 0.01)
    points = RNG.normal(size=(20, 2))
    found = fitting.rotational_fraction(posterior, points)
    assert found.value == pytest.approx(0.5)
    assert found.sd == pytest.approx(0.5 * 0.01 * np.sqrt(2), rel=1e-6)
    with pytest.raises(InputError, match="KernelMixture and one or more points"):
        fitting.rotational_fraction(posterior, points[:0])


def test_the_delta_method_is_exact_for_a_linear_quantity():
    covariance = np.array([[2.0, 0.5], [0.5, 1.0]])
    model = swimmer(HarmonicTrap(1.0, [2.0, 0.0]))
    posterior = posterior_of(model, lambda m: m.environment.center, covariance)
    row = jnp.array([[1.0, -3.0]])
    (found,) = fitting.derive(posterior, lambda m: row @ m.environment.center)
    assert found.value == pytest.approx(2.0)
    assert found.sd**2 == pytest.approx(2.0 - 2 * 3 * 0.5 + 9.0)
