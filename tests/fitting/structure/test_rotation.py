from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from benchmarks.fields.families import random_system
from tests.fitting.structure.observed_forces import observed_forces

from pinav.dynamics import FixedStep
from pinav.errors import FitError
from pinav.fitting import EvidenceFit, Outcome, fit_structured
from pinav.fitting.bayes.neural import FitSpecification
from pinav.fitting.environments.kernels import kernel_environment
from pinav.fitting.evidence.model_evidence import DECISIVE
from pinav.fitting.evidence.quadratic import Quadratic, restrict
from pinav.fitting.structure import fit as structure_fit
from pinav.fitting.structure.search import Search, StructuredFit
from pinav.fitting.structure.starts import Region, central_term
from pinav.fitting.structure.survey import Survey, SurveyedRotation, survey_rotation
from pinav.fitting.structure.trials import Proposal
from pinav.forces import (
    GaussianBarrier,
    GaussianSwirl,
    HillsTerm,
    KernelMixture,
    KernelPlaces,
    KernelPotential,
    StructuredForce,
    kernel_centers,
)
from pinav.scenarios import scenario
from pinav.trajectories import simulate, with_velocities

POINTS = np.random.default_rng(1).uniform(0.0, 10.0, (1, 150, 2))
PULL = GaussianBarrier(-3.0, [4.0, 6.0], 2.0)
SWIRL = GaussianSwirl(1.0, [6.0, 5.0], 2.0)
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


@pytest.fixture
def ended(monkeypatch):
    """Searches whose fits end as they are told, without any data."""
    truth = scenario("barrier-crossings")
    data = simulate(truth, key=jax.random.key(0))
    model = truth.swimmer.with_environment(kernel_environment(KernelPotential, data))
    asked = FitSpecification(model, data, lambda _: (), None, FixedStep())
    made = Search(asked, 20, None, throw=False)
    survey = Survey(response(PULL), Region.of(POINTS[0]), 0.05, is_begun=True)

    def weigh(
        surveyed,
        beside,
        fitted,
        potential,
        mixture,
        *,
        is_plain=False,
        is_rugged=False,
        proposal=None,
        fit_free=None,
    ):
        def best(self, proposal, fit_free=None):
            outcome = mixture if isinstance(self.kernels, KernelMixture) else potential
            if outcome is None:
                raise FitError("it failed")
            fit = object.__new__(EvidenceFit)
            object.__setattr__(fit, "model", self.specification.model)
            object.__setattr__(fit, "outcome", outcome)
            return StructuredFit(fit, 0.0)

        asked = SurveyedRotation(surveyed, surveyed > DECISIVE, is_plain)
        monkeypatch.setattr(Survey, "proposal", proposal or propose_nothing)
        monkeypatch.setattr(structure_fit, "survey_rotation", lambda *_: asked)
        monkeypatch.setattr(structure_fit, "_rotation_beside", lambda *_: beside)
        monkeypatch.setattr(structure_fit, "fitted_gain", lambda _: fitted)
        monkeypatch.setattr(Search, "best", best)
        found = structure_fit._weigh_rotation(
            made, survey, fit_free or made.fit_free, is_rugged=is_rugged
        )
        return type(found.fit.model.environment), found.fit.outcome, found.rotation

    return weigh


def propose_nothing(survey, *, rotational):
    return None


@pytest.mark.parametrize("is_plain", [False, True])
def test_hills_come_first_in_a_rugged_field_without_a_plain_rotation(
    ended, monkeypatch, is_plain
):
    """Nine hills that stand apart end the search; beside them a rotation is weighed."""
    places = 4.0 * jnp.arange(9.0)[:, None] * jnp.array([[1.0, 0.0]])
    hills = HillsTerm(weights=jnp.zeros(27), centers=places, shapes=jnp.zeros((9, 3)))
    weighed = []

    def weigh_beside(search, still, proposal):
        weighed.append((still.gain, proposal))
        return still

    def fit_hills():
        fit = object.__new__(EvidenceFit)
        kernels = KernelPotential.with_zero_weights(POINTS[0][:3], 1.0)
        model = SimpleNamespace(environment=StructuredForce((hills,), kernels))
        object.__setattr__(fit, "model", model)
        object.__setattr__(fit, "outcome", FINE)
        return StructuredFit(fit, 900.0)

    monkeypatch.setattr(Survey, "is_hopeless", lambda *_, **__: True)
    monkeypatch.setattr(structure_fit, "_weigh_beside", weigh_beside)
    options = {"is_rugged": True, "is_plain": is_plain, "fit_free": fit_hills}
    ended(80.0, 90.0, 40.0, FINE, FINE, **options)
    assert weighed == ([] if is_plain else [(900.0, None)])


FINE, BAD = Outcome.CONVERGED, Outcome.DIVERGED


@pytest.mark.parametrize(
    ("gains", "potential", "mixture", "kind", "rotation"),
    [
        ((-9.0, 90.0, 40.0), FINE, FINE, KernelPotential, -9.0),
        ((80.0, 90.0, 40.0), FINE, FINE, KernelMixture, 40.0),
        ((80.0, -4.0, 40.0), FINE, FINE, KernelPotential, -4.0),
        ((80.0, 90.0, 1.0), FINE, FINE, KernelPotential, 1.0),
        ((-9.0, 90.0, 40.0), BAD, FINE, KernelMixture, 40.0),
        ((-9.0, 90.0, 40.0), None, FINE, KernelMixture, 40.0),
        ((80.0, 90.0, 40.0), FINE, BAD, KernelPotential, None),
    ],
)
def test_the_evidence_of_the_fit_decides_and_a_potential_that_fails_yields(
    ended, gains, potential, mixture, kind, rotation
):
    taken, outcome, told = ended(*gains, potential, mixture)
    assert (taken, outcome) == (kind, FINE)
    assert np.isnan(told) if rotation is None else told == rotation


def test_a_mixture_that_failed_is_not_fitted_again_beside_the_potential(ended):
    taken, outcome, told = ended(80.0, -4.0, 40.0, FINE, BAD, is_plain=True)
    assert (taken, outcome) == (KernelPotential, FINE)
    assert np.isnan(told)


def test_where_a_rotation_is_plain_no_potential_is_sought(ended):
    sought = []

    def propose(survey, *, rotational):
        sought.append(rotational)
        swirl = central_term(survey.region, survey.region.middle, rotational=True)
        return Proposal((swirl,), 0.0, 0.05)

    taken, _, told = ended(
        80.0, 90.0, 40.0, FINE, FINE, is_plain=True, proposal=propose
    )
    assert (taken, told, sought) == (KernelMixture, 40.0, [True])


def test_where_both_fail_the_error_is_that_of_the_potential(ended):
    with pytest.raises(FitError, match="it failed"):
        ended(-9.0, -9.0, 40.0, None, None)
    assert ended(-9.0, -9.0, 40.0, BAD, None)[:2] == (KernelPotential, BAD)


@pytest.mark.slow
def test_trajectories_of_a_vortex_show_its_rotation_before_any_fit():
    truth = random_system("vortex", 0)
    data = simulate(truth.with_starts(count=6), key=jax.random.key(0))
    positions = with_velocities(data.only(("x", "y")))
    kernels = kernel_environment(KernelPotential, positions, dim=2)
    model = truth.swimmer.with_environment(kernels)
    with jax.enable_x64(new_val=True):
        asked = FitSpecification(model, positions, lambda _: (), None, FixedStep())
        survey = Survey.of(asked, asked.problem(model))
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
