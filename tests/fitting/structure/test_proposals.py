import dataclasses

import numpy as np
import pytest
from tests.fitting.structure.observed_forces import observed_forces

from pinav.fitting.evidence.evidence import LinearisedObservations, at_shape
from pinav.fitting.structure.candidates import (
    AGAIN,
    ENOUGH,
    FIRST_PAIRS,
    Candidates,
)
from pinav.fitting.structure.patterns import twins
from pinav.fitting.structure.proposals import fallbacks, propose, prune, refine
from pinav.fitting.structure.response import AT_ONCE, force_quadratic
from pinav.fitting.structure.starts import (
    Region,
    central_term,
    linear_term,
    segments,
    wall_term,
)
from pinav.fitting.structure.survey import Survey
from pinav.fitting.structure.trials import (
    Proposal,
    cost,
    polish,
    quick_evidences,
    with_places,
)
from pinav.forces import (
    GaussianBarrier,
    LinearForce,
    ObstaclesTerm,
    gaussian_ridge,
    ring_barrier,
    soft_wall,
)
from pinav.forces.fitted_laws import FittedLaw
from pinav.forces.structures import prior_of

POINTS = np.random.default_rng(1).uniform(0.0, 10.0, (1, 150, 2))
REGION = Region.of(POINTS[0])


HILL = GaussianBarrier(3.0, [4.0, 6.0], 1.5)
SADDLE = LinearForce(np.array([[2.0, 0.5], [0.5, -2.0]]), [5.0, 5.0])


def response(truth, noise=0.01):
    return observed_forces(truth, POINTS, noise)


def test_a_centre_is_polished_from_nearby():
    data = response(GaussianBarrier(3.0, [4.0, 6.0], 1.5))
    made = polish((central_term(REGION, np.array([4.3, 5.8])),), data)
    np.testing.assert_allclose(made.terms[0].center, [4.0, 6.0], atol=0.02)
    assert made.noise == pytest.approx(0.01, rel=0.2)


@pytest.mark.slow
def test_a_polish_begins_anew_until_that_gains_nothing():
    data = response(HILL + soft_wall(6.0, 0.7, 9.0, 0.8))
    terms = central_term(REGION, np.array([4.8, 5.0])), wall_term(REGION, 0.5)
    once = polish(terms, data)
    often = polish(terms, data, again=3)
    assert often.log_evidence >= once.log_evidence
    for between in ((2 * once.noise, np.inf), (0.0, 0.5 * once.noise)):
        left = polish(terms, data, again=3, between=between)
        assert left.log_evidence == once.log_evidence


def test_the_evidence_prefers_the_kind_that_is_right():
    data = response(soft_wall(4.0, 0.7, 7.0, 0.8))
    walls = quick_evidences([wall_term(REGION, a) for a in (0.7, 1.2)], (), data)
    others = [linear_term(REGION), central_term(REGION, np.array([7.0, 5.0]))]
    values = [quick_evidences([term], (), data)[0] for term in others]
    assert walls[0] > max(*values, walls[1]) + 20


def test_each_of_many_terms_has_the_evidence_that_it_has_alone():
    """More of them than are computed in one call, beside a linear term."""
    data, linear = response(HILL + SADDLE), linear_term(REGION)
    starts = [central_term(REGION, p) for p in REGION.grid(6)]
    assert len(starts) > AT_ONCE
    values = quick_evidences(starts, (linear,), data)
    for value, start in list(zip(values, starts, strict=True))[::9]:
        quadratic = force_quadratic((linear, start), data)
        prior = prior_of((linear, start))
        shapes = [prior.start.copy(), prior.start.copy()]
        first = len(linear.prior().start)
        shapes[0][first], shapes[1][first] = np.log(3.6), np.log(1.44)
        seen = LinearisedObservations.of(quadratic)
        whole = [at_shape(seen, prior.covariance, s).log_evidence for s in shapes]
        price = cost((linear, start), data)
        assert value == pytest.approx(max(whole) - price, abs=1e-5)


@pytest.mark.parametrize(
    ("truth", "kinds"),
    [
        (SADDLE, ["linear"]),
        pytest.param(
            HILL + SADDLE, ["linear", "central"], marks=pytest.mark.slow, id="sum"
        ),
    ],
)
def test_the_search_names_what_is_there_and_nothing_beside_it(truth, kinds):
    found = propose(response(truth), REGION, 0.01, rotational=False)
    assert [term.kind for term in found.terms] == kinds


def test_one_centre_stands_for_obstacles_that_no_fit_carries():
    linear = linear_term(REGION)
    (several,) = twins(
        central_term(REGION, np.array([3.0, 4.0])), np.array([[5.0, 8.0]])
    )
    (_, single), rest = fallbacks((linear, several))
    assert single.kind == "central"
    np.testing.assert_allclose(single.center, [4.0, 6.0])
    assert rest == (linear,)
    assert not list(fallbacks((single,)))


def test_what_no_force_explains_is_noise():
    data = response(HILL)
    assert data.least_noise == np.inf  # a force explains each datum
    more = dataclasses.replace(data, num_free=data.num_free + 50, squares=50 * 0.02**2)
    assert more.least_noise == pytest.approx(0.02)


SEGMENT = gaussian_ridge(3.0, [4.4, 6.4], 4.9, 0.7, 2.0)
"""Seven times as long as wide: half the logarithm of that is 0.97."""


@pytest.mark.slow
def test_a_segment_is_a_long_ellipse_along_the_layers_of_a_wall():
    data = response(SEGMENT)
    normal = 2.0 - 0.5 * np.pi
    (wall,) = polish((wall_term(REGION, normal + 0.05),), data).terms
    starts = segments(REGION, wall)
    best = starts[int(np.argmax(quick_evidences(starts, (), data)))]
    made = polish((best,), data)
    np.testing.assert_allclose(made.terms[0].center, SEGMENT.constants[1:3], atol=0.1)
    shear = 0.5 * np.log(7.0) * np.array([np.cos(2 * normal), np.sin(2 * normal)])
    np.testing.assert_allclose(made.terms[0].shear, shear, atol=0.03)
    assert made.noise == pytest.approx(0.01, rel=0.2)


@pytest.mark.slow
def test_an_ellipse_is_found_beside_the_wall_of_a_pair():
    ridge = gaussian_ridge(3.0, [4.0, 5.0], 3.0, 1.1, 0.6)
    data = response(ridge + soft_wall(6.0, 0.7, 9.5, 0.8))
    candidates = Candidates.of(data, REGION, 0.01, ENOUGH)
    linear = linear_term(REGION)
    circle, wall = central_term(REGION, np.array([6.0, 3.0])), wall_term(REGION, 0.72)
    pair = polish((linear, circle, wall), data)
    (terms,) = candidates.beside_walls([pair, pair], linear)  # each wall once
    made = polish(terms, data, again=AGAIN, between=(0.014, 0.05))
    np.testing.assert_allclose(made.terms[2].center, ridge.constants[1:3], atol=0.05)
    assert made.noise == pytest.approx(0.01, rel=0.3)


@pytest.mark.slow
def test_where_the_first_pairs_are_hopeless_no_others_are_polished():
    data = response(HILL + SADDLE)
    candidates = Candidates.of(data, REGION, 1e-4, ENOUGH)  # so is all that is left
    made = candidates.pair(rotational=False)
    pairs = [one for one in made if not isinstance(one.terms[-1], ObstaclesTerm)]
    assert 0 < len(pairs) <= FIRST_PAIRS


@pytest.mark.parametrize(
    ("noise", "again", "would_repeat"),
    [(0.04, 0.041, True), (0.04, 0.05, False), (0.03, 0.03, False)],
)
def test_a_search_is_not_repeated_where_data_tell_the_same(noise, again, would_repeat):
    """Unless it had ended early, because terms left little more than the noise."""
    survey = Survey(response(HILL), REGION, 0.02, is_begun=True)
    first, second = (
        Proposal((linear_term(REGION),), 0.0, one) for one in (noise, again)
    )
    assert survey.would_repeat(first, second) is would_repeat
    assert not survey.would_repeat(first, None)


def test_the_layers_of_a_shear_flow_hold_no_segments():
    assert not segments(REGION, wall_term(REGION, 0.7, rotational=True))


SPACE = np.random.default_rng(1).uniform(0.0, 10.0, (1, 150, 3))


@pytest.mark.slow
def test_a_centre_is_found_in_space():
    center = [4.0, 6.0, 5.0]
    truth = GaussianBarrier(3.0, center, 2.0)
    data = observed_forces(truth, SPACE, 0.01)
    found = propose(data, Region.of(SPACE[0]), 0.01, rotational=True)
    assert [term.kind for term in found.terms] == ["central"]
    np.testing.assert_allclose(found.terms[0].center, center, atol=0.03)


@pytest.mark.slow
def test_a_needless_term_goes_and_a_needed_one_stays():
    data = response(HILL + SADDLE)
    hill = central_term(REGION, np.array([4.1, 5.9]))
    both = polish((linear_term(REGION), hill), data)
    assert len(prune(both, data).terms) == 2
    spare = polish((wall_term(REGION, 1.2), hill), response(HILL))
    (term,) = prune(spare, response(HILL)).terms
    assert term.kind == "central"


@pytest.mark.slow
def test_profiles_become_finer_where_the_data_ask_for_it():
    narrow = ring_barrier(2.0, [5.0, 5.0], 3.0, 0.15)
    data = response(narrow)
    coarse = polish((central_term(REGION, np.array([5.02, 5.0])),), data)
    finer = refine(coarse, data)
    assert finer.terms[0].width < coarse.terms[0].width
    assert finer.log_evidence > coarse.log_evidence
    smooth = polish((central_term(REGION, np.array([4.1, 5.9])),), response(HILL))
    assert refine(smooth, response(HILL)) is smooth


def test_kernels_of_a_profile_are_fine_where_few_swimmers_are_flung_out():
    flung = np.concatenate([POINTS[0], [[60.0, 5.0]]])
    assert Region.of(flung).extent == pytest.approx(60.0, rel=0.02)
    assert Region.of(flung).width == pytest.approx(60.0 / 81, rel=0.02)
    assert REGION.width == pytest.approx(10.0 / 36, rel=0.02)


def test_what_no_force_explains_counts_as_noise():
    data = response(HILL)
    noisy = dataclasses.replace(data, squares=3 * data.num_free * 0.01**2)
    hill = (central_term(REGION, np.array([4.1, 5.9])),)
    assert polish(hill, noisy).noise == pytest.approx(0.02, rel=0.1)


def test_a_term_that_left_the_data_is_no_proposal():
    far = central_term(REGION, np.array([1e6, 0.0]))
    assert polish((far,), response(SADDLE)) is None


RING = FittedLaw("ring", (3.0, 0.1, 0.2))


def test_finer_kernels_and_single_centres_keep_the_law():
    center, law = central_term(REGION, np.array([4.0, 6.0])), RING
    lawful = with_places(center, np.asarray(center.places), center.width, law)
    (several,) = twins(lawful, np.array([[5.0, 8.0]]))
    assert several.law is law
    (single,) = next(iter(fallbacks((several,))))
    assert single.law is law
    rough = Proposal((lawful,), 0.0, 1.0, (1.0,))
    (finer,) = rough.finer
    assert finer.law is law
    assert len(finer.weights) == 1 + len(finer.places)
