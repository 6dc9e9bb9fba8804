import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from benchmarks.fields.families import random_system

from pinav.dynamics import FixedStep
from pinav.fitting import fit_structured, structured
from pinav.fitting.bayes.neural import FitSpecification
from pinav.fitting.environments.kernels import KernelGrid, kernel_environment
from pinav.fitting.evidence.model_evidence import DECISIVE
from pinav.fitting.outcome import Outcome
from pinav.fitting.structure.fits import Fits, StructuredFit
from pinav.fitting.structure.starts import Region, linear_term
from pinav.fitting.structure.survey import Survey
from pinav.fitting.structure.trace import Trace
from pinav.fitting.structured import survey_first_steps
from pinav.forces import (
    AbstractProfileTerm,
    KernelMixture,
    KernelPotential,
    StructuredForce,
    forces_at,
)
from pinav.scenarios.planar import fibres
from pinav.scenarios.viscous import box
from pinav.systems.files import parse_system
from pinav.trajectories import simulate, with_velocities

PLACES = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])


def test_a_force_is_named_by_its_terms_and_its_free_kernels():
    mixture = KernelMixture.with_zero_weights(PLACES, 1.0)
    structured = StructuredForce((linear_term(Region.of(PLACES)),), mixture)
    assert structured.kind == "linear + kernel-mixture"
    potential = KernelPotential.with_zero_weights(PLACES, 1.0)
    assert potential.kind == "kernel-potential"


def saddle():
    """A force that is linear, an untrained model, and what was observed."""
    truth = random_system("saddle", 0)
    data = simulate(truth.with_starts(count=6), key=jax.random.key(0))
    positions = data.only(("x", "y"))
    kernels = kernel_environment(KernelPotential, positions, dim=2)
    return truth, truth.swimmer.with_environment(kernels), positions


@pytest.mark.slow
def test_a_linear_force_is_found_and_each_step_names_what_is_fitted():
    truth, model, positions = saddle()
    fitted: list[str] = []
    found = fit_structured(
        model,
        positions,
        weigh_rotation=True,
        on_step=lambda progress: fitted.append(progress.force),
    )
    assert found.structure is not None
    assert [term.kind for term in found.structure.terms] == ["linear"]
    assert {"linear + kernel-potential", "kernel-potential"} <= set(fitted)
    places, times = jnp.asarray(2.0 + 6.0 * PLACES), jnp.zeros(3)
    true = forces_at(truth.environment, times, places)
    learned = forces_at(found.fit.model.environment, times, places)
    assert jnp.linalg.norm(learned - true) < 0.05 * jnp.linalg.norm(true)


@pytest.mark.slow
def test_a_fit_that_diverges_ends_in_pieces_of_the_trajectories(monkeypatch):
    truth, model, positions = saddle()

    def diverge(fits):
        return StructuredFit(dataclasses.replace(fits.fit(), outcome=Outcome.DIVERGED))

    monkeypatch.setattr(structured, "fit_free", diverge)
    fit = fit_structured(model, positions.select([0, 1, 2]), throw=False)
    assert fit.fit.outcome is Outcome.MISFIT
    assert fit.trace[-1].ended == "free kernels of pieces of trajectories misfit"
    assert fit.fit.states.shape[:2] == positions.times[:3].shape


@pytest.mark.slow
def test_where_the_evidence_cannot_tell_terms_alone_are_preferred():
    """Free kernels of the width of a hill explain it as well as a profile does."""
    truth, model, positions = drawn("gaussian", 47)
    fit = fit_structured(model, positions)
    assert abs(fit.gain) < DECISIVE
    (term,) = fit.structure.terms
    np.testing.assert_allclose(term.center, truth.environment.center, atol=0.1)


@pytest.mark.slow
def test_no_force_is_not_called_a_linear_one():
    _, model, positions = drawn("none", 40)
    fit = fit_structured(model, positions)
    assert abs(fit.gain) < DECISIVE
    assert fit.structure is None


def drawn(family, key):
    """A system, its model with kernels that know nothing, and simulated positions."""
    system = random_system(family, key).with_starts(count=16)
    data = simulate(system, key=jax.random.key(key)).only(("x", "y"))
    kernels = kernel_environment(KernelPotential, data, dim=2)
    return system, system.swimmer.with_environment(kernels), data


def rugged(scenario, seed):
    """A scenario as `pinav simulate` draws it, its untrained model, and its data."""
    truth_key, noise_key = jax.random.split(jax.random.key(seed))
    truth = scenario(key=truth_key)
    data = simulate(truth, key=noise_key)
    kernels = kernel_environment(KernelPotential, data)
    return truth, truth.swimmer.with_environment(kernels), data


@pytest.mark.slow
def test_a_rugged_field_is_hills_of_their_own_places_and_shapes():
    """Twelve fibres, one of which no swimmer came near."""
    truth, model, data = rugged(fibres, 3)
    fit = fit_structured(model, data, weigh_rotation=True)
    assert fit.fit.outcome is Outcome.CONVERGED
    assert fit.gain > 1000.0
    (term,) = fit.structure.terms
    assert term.kind == "hills and wells"
    centers = np.asarray(truth.environment.stacked.constants[:, 1:3])
    gaps = np.linalg.norm(np.asarray(term.centers)[:, None] - centers, axis=-1)
    assert np.sum(gaps.min(axis=0) < 0.2) >= 9
    close = np.asarray(term.shapes)[gaps.min(axis=1) < 0.2]
    lengths = np.exp(close[:, 0] + np.hypot(close[:, 1], close[:, 2]))
    np.testing.assert_allclose(lengths, 2.5, rtol=0.05)


HILL = """
dimension = 2
order = 2
drag = {drag!r}

[propulsion]
kind = "magnetic-propulsion"
moment = [0.0, 0.0, 1.0]
gain = {gain!r}
axis = [0.0, 1.0]
field = {{ kind = "rotating-field", amplitude = 1.0, frequency = {turning!r} }}

[observation]
noise = {noise!r}

[unknown]
model = "kernel-potential"

[truth]
kind = "gaussian-barrier"
height = {height!r}
center = [{center!r}, {center!r}]
width = {width!r}

[starts]
kind = "coasting-starts"
lower = [0.0, 0.0]
upper = [{side!r}, {side!r}]
damping = {drag!r}
count = 16

[times]
first = 0.0
last = {last!r}
samples = 201
"""


@pytest.mark.slow
def test_a_hill_is_found_in_any_units():
    """One swimmer, stated in three pairs of units of length and time."""
    gains = []
    for length, time in ((1.0, 1.0), (64.0, 0.0625), (0.03125, 128.0)):
        acceleration = length / time**2
        text = HILL.format(
            drag=0.36 / time,
            gain=0.034 * acceleration,
            turning=6.283185307179586 / time,
            noise=0.02 * length,
            height=2.0 * acceleration * length,
            center=5.0 * length,
            width=1.5 * length,
            side=10.0 * length,
            last=20.0 * time,
        )
        system = parse_system(text)
        data = simulate(system, key=jax.random.key(1)).only(("x", "y"))
        kernels = kernel_environment(KernelPotential, data, dim=2)
        model = system.swimmer.with_environment(kernels)
        fit = fit_structured(model, data)
        assert fit.structure is not None
        assert [term.kind for term in fit.structure.terms] == ["central"]
        gains.append(fit.gain)
    assert max(gains) - min(gains) < 0.5
    assert min(gains) > 5.0


def fits_of(model, data):
    """Fits of kernels that know nothing to data of the states of a model."""
    asked = FitSpecification(model, data, lambda _: (), None, FixedStep())
    return Fits(asked, 20, None, throw=False, trace=Trace())


@pytest.mark.parametrize("turns", [False, True])
def test_the_true_terms_explain_more_than_free_kernels_about_their_states(turns):
    _, model, positions = saddle()
    with jax.enable_x64(new_val=True):
        fits = fits_of(model, with_velocities(positions))
        fits = fits.turning() if turns else fits
        survey = Survey.of(fits, fits.begin())
        best = survey.search(rotational=False).run(singles_only=True)[0]
    assert [term.kind for term in best.terms] == ["linear"]
    assert 0 < best.log_evidence - survey.log_evidence < 200


@pytest.mark.slow
def test_quick_swimmers_are_surveyed_about_the_first_steps_of_a_fit():
    """Smoothed states miss their path; about those an ellipse lay off the data."""
    truth, model, positions = drawn("elliptic", 43)
    with jax.enable_x64(new_val=True):
        begun, survey = survey_first_steps(fits_of(model, with_velocities(positions)))
        (term,) = survey.propose(survey.search(rotational=False))[0].terms
    assert begun.states is not None
    assert survey.is_begun
    assert survey.noise == pytest.approx(0.02, rel=0.1)
    assert term.kind == "elliptic"
    np.testing.assert_allclose(term.center, truth.environment.constants[1:3], atol=0.02)


@pytest.mark.slow
def test_the_noise_is_told_where_a_thrust_turns_at_once():
    """Smoothed states miss such paths by five times the error of 0.02."""
    data = simulate(box(count=4), key=jax.random.key(0))
    kernels = kernel_environment(KernelPotential, data, KernelGrid(3), dim=3)
    fits = fits_of(box().swimmer.with_environment(kernels), data)
    with jax.enable_x64(new_val=True):
        noise = Survey.of(fits).noise
        assert fits.problem().first_noise > 0.06
    assert noise == pytest.approx(0.02, rel=0.2)


@pytest.mark.slow
def test_a_fit_whose_time_is_over_is_the_best_so_far():
    """Of a hill with a budget of nothing the first proposal is fitted, and no more."""
    _, model, positions = drawn("compact", 42)
    fit = fit_structured(model, positions, weigh_rotation=True, budget=0.0)
    assert fit.structure is not None
    assert [term.kind for term in fit.structure.terms] == ["central"]
    assert np.isnan(fit.gain)
    assert any(one.ended.startswith("its fit") for one in fit.trace)
    assert not any("free kernels" in one.ended for one in fit.trace)


def fitted_law(family, key, kind):
    """A system, the force fitted to its positions, and the law of its only term."""
    truth, model, positions = drawn(family, key)
    result = fit_structured(model, positions)
    assert result.structure is not None
    (term,) = result.structure.terms
    assert isinstance(term, AbstractProfileTerm)
    assert term.law.name == kind
    return truth.environment, result.force, term.law


def relative_error(force, truth, places):
    times = jnp.zeros(len(places))
    true, learned = (forces_at(one, times, places) for one in (truth, force))
    return jnp.linalg.norm(learned - true) / jnp.linalg.norm(true)


@pytest.mark.slow
def test_a_hill_that_ends_follows_its_law_beyond_the_data():
    truth, force, law = fitted_law("compact", 42, "hill")
    np.testing.assert_allclose(law.constants()["tail"], -1 / 3, atol=0.02)
    places = jnp.asarray(np.random.default_rng(1).uniform(0.0, 10.0, (200, 2)))
    assert relative_error(force, truth, places) < 0.01


@pytest.mark.slow
def test_a_well_that_swimmers_circle_is_found():
    """About smoothed states the right centre leaves four times the noise."""
    _, model, positions = drawn("lorentzian", 59)
    result = fit_structured(model, positions)
    assert result.structure is not None
    assert [term.kind for term in result.structure.terms] == ["central"]
