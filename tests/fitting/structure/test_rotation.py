import jax
import jax.numpy as jnp
import numpy as np
import pytest
from benchmarks.fields.families import random_system
from tests.fitting.structure.observed_forces import observed_forces

from pinav.dynamics import FixedStep
from pinav.fitting import Outcome, fit_structured
from pinav.fitting.bayes.neural import FitSpecification
from pinav.fitting.environments.kernels import kernel_environment
from pinav.fitting.evidence.model_evidence import DECISIVE
from pinav.fitting.evidence.quadratic import Quadratic, restrict
from pinav.fitting.structure.fits import Fits
from pinav.fitting.structure.rotation import survey_rotation
from pinav.fitting.structure.survey import Survey
from pinav.fitting.structure.trace import Trace
from pinav.forces import (
    GaussianBarrier,
    KernelMixture,
    KernelPlaces,
    KernelPotential,
    forces_at,
    gaussian_swirl,
    kernel_centers,
    split_structure,
)
from pinav.scenarios import scenario
from pinav.trajectories import simulate, with_velocities

POINTS = np.random.default_rng(1).uniform(0.0, 10.0, (1, 150, 2))
PULL = GaussianBarrier(-3.0, [4.0, 6.0], 2.0)
SWIRL = gaussian_swirl(1.0, [6.0, 5.0], 2.0)
KERNELS = KernelPlaces(kernel_centers(POINTS[0], spacing=1.2, margin=2.4), 1.2)


def response(truth):
    return observed_forces(truth, POINTS, 0.05)


def test_the_evidence_asks_for_a_rotational_part_where_the_force_turns():
    assert survey_rotation(response(PULL), 0.05, (), KERNELS).gain < DECISIVE
    assert survey_rotation(response(PULL + SWIRL), 0.05, (), KERNELS).gain > 50


def test_parameters_that_are_restricted_to_zero_leave_the_same_squares():
    rng = np.random.default_rng(3)
    factor, kept = rng.normal(size=(5, 5)), np.array([True, False, True, True, False])
    whole = Quadratic(
        point=rng.normal(size=5),
        hessian=factor @ factor.T,
        gradient=rng.normal(size=5),
        squares=7.0,
        num_free=20,
        log_determinant=0.3,
    )

    def value(quadratic, theta):
        change = theta - quadratic.point
        slope = 2 * quadratic.gradient + quadratic.hessian @ change
        return quadratic.squares + slope @ change

    theta = np.where(kept, rng.normal(size=5), 0.0)
    assert value(restrict(whole, kept), theta[kept]) == pytest.approx(
        value(whole, theta)
    )


@pytest.mark.slow
@pytest.mark.parametrize("truth", [PULL, SWIRL, PULL + SWIRL])
def test_the_fit_turns_where_the_force_does(truth):
    """The evidence decides between a potential and a mixture."""
    system = scenario("barrier-crossings", count=8).with_truth(truth)
    data = simulate(system, key=jax.random.key(2))
    model = system.swimmer.with_environment(kernel_environment(KernelPotential, data))
    found = fit_structured(model, data, weigh_rotation=True)
    turns = truth is not PULL
    assert found.fit.outcome is Outcome.CONVERGED
    assert (found.rotation > DECISIVE) == turns
    _, rest = split_structure(found.force)
    assert isinstance(rest, KernelMixture if turns else KernelPotential)
    places = jnp.asarray(data.positions.reshape(-1, 2)[::7])
    true, learned = (
        forces_at(one, jnp.zeros(len(places)), places) for one in (truth, found.force)
    )
    assert jnp.linalg.norm(learned - true) < 0.05 * jnp.linalg.norm(true)


@pytest.mark.slow
def test_trajectories_of_a_vortex_show_its_rotation_before_any_fit():
    truth = random_system("vortex", 0)
    data = simulate(truth.with_starts(count=6), key=jax.random.key(0))
    positions = with_velocities(data.only(("x", "y")))
    kernels = kernel_environment(KernelPotential, positions, dim=2)
    model = truth.swimmer.with_environment(kernels)
    with jax.enable_x64(new_val=True):
        asked = FitSpecification(model, positions, lambda _: (), None, FixedStep())
        survey = Survey.of(Fits(asked, 20, None, throw=False, trace=Trace()))
        found = survey_rotation(survey.response, survey.noise, (), kernels.kernels)
    assert found.gain > 100


@pytest.mark.slow
@pytest.mark.parametrize("truth", [PULL, SWIRL])
def test_two_trajectories_tell_whether_a_force_turns(truth):
    """They are too few for a search of a structure; the evidence is asked anyway."""
    system = scenario("barrier-crossings", count=2).with_truth(truth)
    data = simulate(system, key=jax.random.key(2))
    kernels = kernel_environment(KernelPotential, data)
    model = system.swimmer.with_environment(kernels)
    fit = fit_structured(model, data, weigh_rotation=True)
    turns = isinstance(fit.fit.model.environment, KernelMixture)
    assert turns == (truth is SWIRL)
    assert (fit.rotation > DECISIVE) == turns
    assert np.isnan(fit.gain)
