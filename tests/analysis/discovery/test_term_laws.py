import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from benchmarks.open_forms import sample_profile
from tests.fitted_runs import crossing_system

from pinav import forces
from pinav.analysis import Verdict, discover_law
from pinav.analysis.discovery.candidates import LIBRARY
from pinav.analysis.discovery.force_sample import ForceSample, Sampling
from pinav.analysis.discovery.law_regression import (
    exchange_terms,
    fit_law,
    fit_sum,
    is_explained,
    law_force,
    screen,
    screen_terms,
)
from pinav.analysis.discovery.refit import laplace_posterior
from pinav.analysis.discovery.term_laws import (
    TermLaws,
    laws_of,
    term_landscape,
    term_laws,
)
from pinav.errors import InputError
from pinav.fitting.engine.local_model import known_model
from pinav.fitting.environments.summary import learned_part
from pinav.forces.fitted_laws import FittedLaw
from pinav.forces.geometries import Center
from pinav.forces.law_library import (
    ANISOTROPIC_TRAP,
    GAUSSIAN,
    LATTICES,
    RING,
    SADDLE,
    WALL,
    turn,
)
from pinav.forces.laws import ProfileLaw
from pinav.forces.profiles import SuperGaussian
from pinav.forces.terms import HARMONICS
from pinav.systems import Observation
from pinav.trajectories import simulate

POSITIONS = np.random.default_rng(0).uniform(0.0, 8.0, (60, 2))
PLACES, NONE = jnp.linspace(0.5, 4.0, 5), jnp.zeros(0)
CENTER = jnp.array([3.0, 4.5])


def sample_of(force):
    return ForceSample(POSITIONS, force, 1e-6 * np.eye(force.size), 40.0)


def hill(center=CENTER, **options):
    law = FittedLaw("hill", (jnp.log(2.9), jnp.asarray(0.0)))
    return forces.CentralTerm(jnp.array([5.25]), center, NONE, 1.0, law=law, **options)


def wall(angle=0.7):
    return forces.WallTerm(jnp.ones(5), angle, jnp.zeros(2), PLACES, 0.8)


def term_of(term, law, constants):
    """A term whose force is that of a law, with the candidates of its kind."""
    sample = sample_of(law_force(law, np.asarray(constants), POSITIONS))
    landscape = term_landscape(term, sample)
    return TermLaws(term.kind, sample, laws_of(term), landscape)


def test_geometry_gives_the_starts():
    sample = sample_of(law_force(GAUSSIAN, np.array([5.0, 3.0, 4.5, 2.0]), POSITIONS))
    assert term_landscape(hill(), sample).centers == ((3.0, 4.5),)
    assert term_landscape(wall(0.3), sample).direction == pytest.approx(0.3)
    ellipse = forces.EllipticTerm(
        jnp.ones(5), CENTER, jnp.array([0.0, 0.4]), PLACES, 0.8
    )
    start = term_landscape(ellipse, sample)
    # e^{2S} is largest at 45 degrees: there the axis is short
    assert start.direction == pytest.approx(np.pi / 4)
    assert start.aspect == pytest.approx(np.exp(-0.8))
    places = jnp.array([[1.0, 2.0], [5.0, 6.0]])
    obstacles = forces.ObstaclesTerm(jnp.ones(5), places, PLACES, 0.8)
    assert term_landscape(obstacles, sample).centers == ((1.0, 2.0), (5.0, 6.0))


def test_the_waves_of_a_lattice_are_its_strongest_harmonics():
    weights = np.zeros((2, len(HARMONICS)))
    weights[0, HARMONICS.index((1, 1))] = 2.0
    weights[1, HARMONICS.index((1, -1))] = 1.5
    vectors = jnp.array([[1.0, 0.0], [0.0, 1.0]])
    lattice = forces.LatticeTerm(jnp.asarray(weights.ravel()), vectors, jnp.zeros(2))
    sample = sample_of(law_force(GAUSSIAN, np.array([5.0, 3.0, 4.5, 2.0]), POSITIONS))
    assert term_landscape(lattice, sample).wave_vectors == ((1.0, 1.0), (1.0, -1.0))


def test_a_swirl_is_asked_for_swirls():
    assert laws_of(hill(rotational=True)) == tuple(map(turn, laws_of(hill())))
    assert GAUSSIAN in laws_of(hill())
    assert RING in laws_of(hill())
    assert set(LATTICES) == set(
        laws_of(forces.LatticeTerm(jnp.ones(12), jnp.eye(2), jnp.zeros(2)))
    )


def test_each_term_of_a_sum_gets_its_law():
    one, two = np.array([4.0, 0.7, 6.0, 0.8]), np.array([5.0, 3.0, 4.5, 1.5])
    terms = [term_of(wall(), WALL, one), term_of(hill(), GAUSSIAN, two)]
    whole = sample_of(terms[0].sample.force + terms[1].sample.force)
    best = screen_terms(terms, whole)[0]
    assert best.law == WALL + GAUSSIAN
    np.testing.assert_allclose(best.constants, [*one, *two], rtol=1e-3)
    assert is_explained(best, whole)


def test_laws_are_added_until_they_explain_a_force_without_structure():
    constants = [np.array([5.0, 3.0, 4.5, 1.2]), np.array([0.3, -0.2, 4.0, 4.0])]
    parts = zip((GAUSSIAN, SADDLE), constants, strict=True)
    sample = sample_of(sum(law_force(*part, POSITIONS) for part in parts))
    fits = screen(sample, (GAUSSIAN, SADDLE, WALL))
    assert set(fits[0].law.terms) == {GAUSSIAN, SADDLE}
    assert max(len(getattr(fit.law, "terms", (0,))) for fit in fits) == 2
    assert is_explained(fits[0], sample)


def test_terms_of_a_sum_are_exchanged_for_simpler_ones():
    """A flat hill and a disc leave as little as what they stand for."""
    flat = ProfileLaw(SuperGaussian(), Center())
    gaussian, saddle = np.array([5.0, 3.0, 4.5, 1.2]), np.array([0.3, -0.2, 4.0, 4.0])
    force = law_force(GAUSSIAN, gaussian, POSITIONS)
    sample = sample_of(force + law_force(SADDLE, saddle, POSITIONS))
    start = fit_sum(fit_law(flat, sample), ANISOTROPIC_TRAP, sample)
    best = min(
        exchange_terms(start, (GAUSSIAN, SADDLE, WALL), sample), key=lambda f: f.bic
    )
    assert set(best.law.terms) == {GAUSSIAN, SADDLE}
    assert exchange_terms(fit_law(GAUSSIAN, sample), (WALL,), sample) == []


@pytest.fixture(scope="module")
def structured():
    """The posterior of a hill that is known to be central, and its data."""
    scenario = crossing_system(4, 61, observation=Observation(0.01))
    data = simulate(scenario, key=jax.random.key(1)).only(("x", "y"))
    rest = forces.KernelPotential.with_zero_weights(POSITIONS[:4], 2.0)
    force = forces.StructuredForce((hill(jnp.array([5.0, 5.0])),), rest)
    model = scenario.truth.with_environment(force)
    with jax.enable_x64(new_val=True):
        return laplace_posterior(model, data, learned_part), data


def test_terms_without_laws_leave_the_whole_force(structured):
    swirls = forces.HillsTerm(
        jnp.ones(3), CENTER[None], jnp.zeros((1, 3)), rotational=True
    )
    linear = forces.LinearTerm(jnp.ones(5), jnp.zeros(2), 1.0)
    assert laws_of(swirls) == ()
    sampling = Sampling.of(*structured, 10.0)
    for terms in ([], [swirls], [linear] * 4):
        assert term_laws(terms, sampling) is None


def test_discovery_begins_with_the_structure(structured):
    """From positions alone, as they are fitted."""
    found = discover_law(*structured, refits=2)
    assert found.structure == ("central",)
    assert {name for name, _ in found.screened} == {law.name for law in laws_of(hill())}
    assert found.best.law == GAUSSIAN
    assert found.verdict is Verdict.IDENTIFIED
    assert found.close == (found.best,)
    assert found.best.terms == ("Gaussian",)
    assert found.candidates[1].extends_best


@pytest.mark.slow
def test_given_laws_are_tried_in_place_of_the_structure(structured):
    assert discover_law(*structured, laws=LIBRARY[:3], refits=1).structure == ()


def test_the_profile_of_a_term_is_known_along_its_coordinate(structured):
    posterior, data = structured
    sampling = Sampling.of(posterior, data, 10.0)
    profile = sample_profile(sampling, 0)
    expected = 5.25 * profile.z / 2.9**2 * np.exp(-(profile.z**2) / (2 * 2.9**2))
    np.testing.assert_allclose(profile.force, expected, rtol=0.01, atol=1e-3)
    assert np.all(np.diff(profile.z) >= 0)
    assert np.all(np.linalg.eigvalsh(profile.total_covariance) > 0)
    term = sampling.sample(lambda force: force.terms[0])
    whole = sampling.sample(lambda force: force)
    np.testing.assert_allclose(term.force, whole.force, atol=1e-12)


def test_a_lattice_has_no_profile(structured):
    posterior, data = structured
    lattice = forces.LatticeTerm(jnp.ones(12), jnp.eye(2), jnp.zeros(2))
    rest = forces.KernelPotential.with_zero_weights(POSITIONS[:4], 2.0)
    model = posterior.model.with_environment(forces.StructuredForce((lattice,), rest))
    other = eqx.tree_at(lambda p: p.free, posterior, known_model(model))
    with pytest.raises(InputError, match=r"term 0 .*\(lattice\) has no profile"):
        sample_profile(Sampling.of(other, data, 10.0), 0)
