import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from tests.fitting.structure.observed_forces import observed_forces

from pinav.fitting.structure.kinds import with_one_less
from pinav.fitting.structure.starts import Region, central_term, obstacles_at
from pinav.fitting.structure.trials import Proposal, polish, with_places
from pinav.forces import GaussianBarrier, LinearForce
from pinav.forces.fitted_laws import FittedLaw

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


def test_what_no_force_explains_is_noise():
    data = response(HILL)
    assert data.least_noise == np.inf  # a force explains each datum
    more = dataclasses.replace(data, num_free=data.num_free + 50, squares=50 * 0.02**2)
    assert more.least_noise == pytest.approx(0.02)


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
    several = obstacles_at(lawful, jnp.array([[4.0, 6.0], [5.0, 8.0]]))
    assert several.law is law
    assert next(with_one_less(several)).law is law
    rough = Proposal((lawful,), 0.0, 1.0, (1.0,))
    (finer,) = rough.finer
    assert finer.law is law
    assert len(finer.weights) == 1 + len(finer.places)
