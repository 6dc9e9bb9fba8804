import numpy as np
import pytest
from tests.fitting.problems import quadratic_of

from pinav.errors import FitError
from pinav.fitting.evidence.evidence import (
    LinearisedObservations,
    Whitened,
    at_shape,
    best_hyperparameters,
    evidence_of_scales,
    shape_slope,
    weight_posterior,
)
from pinav.fitting.evidence.hyperparameter_uncertainty import SHAPE_SD, shape_changes
from pinav.fitting.evidence.quadratic import (
    Quadratic,
    eliminate_flat,
    is_singular,
    joint_posterior,
)
from pinav.fitting.evidence.weights import GaussianWeights
from pinav.forces.priors import AbstractPrior

WEIGHTS, FLAT, ROWS = 4, 2, 30
RNG = np.random.default_rng(1)
DESIGN = RNG.normal(size=(ROWS, WEIGHTS + FLAT))
TRUE = np.array([1.0, -0.5, 0.3, 0.8, 5.0, -3.0])
DATA = DESIGN @ TRUE + 0.1 * RNG.normal(size=ROWS)
MASK = np.arange(WEIGHTS + FLAT) >= WEIGHTS
ABOUT = RNG.normal(size=WEIGHTS + FLAT)


BOUNDS = np.array([[-1.0, 1.0]])


def prior(shape):
    length_scale = np.exp(shape[0])
    distance = np.arange(WEIGHTS)[:, None] - np.arange(WEIGHTS)
    return np.exp(-0.5 * (distance / length_scale) ** 2) + 1e-6 * np.eye(WEIGHTS)


@pytest.fixture
def quadratic():
    """The sum of squares of the linear model, known about an arbitrary point."""
    return quadratic_of(DESIGN, DATA, ABOUT)


@pytest.fixture
def data(quadratic):
    """The same with the flat parameters integrated out."""
    return LinearisedObservations.of(eliminate_flat(quadratic, MASK)[0])


@pytest.fixture
def chosen(data):
    return best_hyperparameters(data, Correlated(), np.zeros(1))


def restricted_likelihood(chosen, prior=prior):
    """Log density of the data with the flat parameters integrated out, directly."""
    weights, flat = DESIGN[:, ~MASK], DESIGN[:, MASK]
    covariance = chosen.noise**2 * np.eye(ROWS)
    covariance += chosen.amplitude**2 * weights @ prior(chosen.shape) @ weights.T
    inverse = np.linalg.inv(covariance)
    information = flat.T @ inverse @ flat
    cross = flat.T @ inverse @ DATA
    return -0.5 * (
        (ROWS - FLAT) * np.log(2 * np.pi)
        + np.linalg.slogdet(covariance)[1]
        + np.linalg.slogdet(information)[1]
        + DATA @ inverse @ DATA
        - cross @ np.linalg.solve(information, cross)
    )


@pytest.mark.parametrize("noise", [None, 0.1, 0.3])
def test_evidence_is_the_normal_density_of_the_data(data, noise):
    chosen = best_hyperparameters(data, Correlated(), np.zeros(1), noise)
    expected = restricted_likelihood(chosen)
    np.testing.assert_allclose(chosen.log_evidence, expected, rtol=1e-8)
    assert noise is None or chosen.noise == noise


def of_low_rank(shape):
    """A prior under which all weights are made of two numbers."""
    root = np.stack([np.ones(WEIGHTS), np.exp(shape[0]) * np.arange(WEIGHTS)], axis=1)
    return root @ root.T


class OfLowRank(AbstractPrior):
    """The prior of `of_low_rank`."""

    start, bounds = np.zeros(1), BOUNDS

    def covariance(self, shape):
        return of_low_rank(shape)

    def pullback(self, shape, pull):
        count = np.arange(WEIGHTS)
        return np.array([2 * np.exp(2 * shape[0]) * count @ pull @ count])


@pytest.mark.parametrize("noise", [None, 0.1])
def test_the_slope_of_the_evidence_holds_for_data_that_no_weights_reach(data, noise):
    shape, step = np.array([0.3]), 1e-4
    lower, chosen, upper = (
        at_shape(data, of_low_rank, shape + s, noise) for s in (-step, 0.0, step)
    )
    white = Whitened.of(data, of_low_rank(shape))
    slope = shape_slope(data, white, chosen, OfLowRank())
    difference = (upper.log_evidence - lower.log_evidence) / (2 * step)
    np.testing.assert_allclose(slope, [difference], rtol=1e-5)


class Correlated(AbstractPrior):
    """The prior of `prior`; `idle` where the shape has no effect."""

    idle: bool = False

    start, bounds = np.zeros(1), BOUNDS

    def covariance(self, shape):
        return prior(np.zeros(1)) if self.idle else prior(shape)

    def pullback(self, shape, pull):
        distance = np.arange(WEIGHTS)[:, None] - np.arange(WEIGHTS)
        squares = (distance / np.exp(shape[0])) ** 2
        slope = squares * np.exp(-0.5 * squares)
        return np.zeros(1) if self.idle else np.array([np.vdot(pull, slope)])


def test_a_prior_of_low_rank_has_the_evidence_and_posterior_of_its_density(data):
    chosen = at_shape(data, of_low_rank, np.zeros(1))
    expected = restricted_likelihood(chosen, of_low_rank)
    np.testing.assert_allclose(chosen.log_evidence, expected, rtol=1e-8)
    covariance = of_low_rank(np.zeros(1))
    mean, spread = weight_posterior(data, covariance, chosen)
    prior_of_data = chosen.amplitude**2 * covariance @ data.rows.T
    gain = prior_of_data @ np.linalg.inv(
        data.rows @ prior_of_data + chosen.noise**2 * np.eye(len(data.targets))
    )
    np.testing.assert_allclose(mean, gain @ data.targets, rtol=1e-8)
    exact = chosen.amplitude**2 * covariance - gain @ prior_of_data.T
    np.testing.assert_allclose(spread, exact, rtol=1e-6, atol=1e-10)


@pytest.mark.parametrize("scale", [0.0, 1e-300])
def test_a_prior_that_underflows_says_that_there_are_no_weights(quadratic, scale):
    data = LinearisedObservations.of(quadratic)
    prior = scale * np.eye(len(quadratic.point))
    chosen = at_shape(data, lambda shape: prior, np.zeros(0))
    assert np.isfinite(chosen.log_evidence)
    mean, covariance = weight_posterior(data, prior, chosen)
    assert np.all(np.isfinite(covariance))
    if scale == 0.0:
        np.testing.assert_array_equal(mean, 0.0)


def test_the_evidence_is_highest_where_the_search_ends_and_the_noise_is_right(
    data, chosen
):
    assert chosen.noise == pytest.approx(0.1, rel=0.3)
    for shape in np.linspace(-1, 1, 9)[:, None]:
        assert at_shape(data, prior, shape).log_evidence < chosen.log_evidence + 1e-4


def test_what_a_shape_adds_follows_from_the_curvature_of_the_evidence(data, chosen):
    step = 1e-3

    def at(shape):
        best = at_shape(data, prior, shape)
        return best.log_evidence, weight_posterior(data, prior(shape), best)[0]

    (upper, above), (middle, _), (lower, below) = (
        at(chosen.shape + s * step) for s in (1, 0, -1)
    )
    precision = (2 * middle - upper - lower) / step**2 + 1 / SHAPE_SD**2
    slope = (above - below) / (2 * step)
    changes = shape_changes(data, Correlated(), chosen)
    found = changes @ changes.T
    expected = np.outer(slope, slope) / precision
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-9)
    assert found.max() > 1e-8
    idle = shape_changes(data, Correlated(idle=True), chosen)
    np.testing.assert_allclose(idle, 0, atol=1e-12)


def test_posterior_is_the_exact_one(quadratic, data, chosen):
    _, block = eliminate_flat(quadratic, MASK)
    covariance = prior(chosen.shape)
    weights = weight_posterior(data, covariance, chosen)
    mean, joint = joint_posterior(block, *weights, chosen.noise)
    precision = DESIGN.T @ DESIGN / chosen.noise**2
    precision[:WEIGHTS, :WEIGHTS] += np.linalg.inv(covariance) / chosen.amplitude**2
    exact = np.linalg.solve(precision, DESIGN.T @ DATA / chosen.noise**2)
    np.testing.assert_allclose(mean, exact, rtol=1e-9)
    np.testing.assert_allclose(joint, np.linalg.inv(precision), rtol=1e-8, atol=1e-12)


def test_constants_that_the_data_leave_open_are_refused():
    twins = quadratic_of(DESIGN[:, [0, 1, 2, 3, 4, 4]], DATA)
    with pytest.raises(FitError, match="singular: the data do not determine the learn"):
        eliminate_flat(twins, MASK)


def test_a_matrix_that_is_not_finite_or_has_a_zero_is_singular():
    assert is_singular(np.diag([1.0, 0.0]))
    assert is_singular(np.array([[np.nan]]))
    assert not is_singular(np.diag([1.0, 1e-20]))
    assert not is_singular(np.zeros((0, 0)))


def test_weights_on_which_no_datum_depends_are_refused():
    """A diverging fit leaves its kernels; all variances of the prior then vanish."""
    nothing = Quadratic(np.zeros(3), np.zeros((3, 3)), np.zeros(3), 1.0, 10, 0.0)
    with pytest.raises(FitError, match="do not depend on the weights"):
        LinearisedObservations.of(nothing)


class Bumpy(AbstractPrior):
    """Two weights, one of which alone is free at either end of the shape."""

    both: bool = True

    @property
    def start(self):
        return np.array([-2.0])

    @property
    def starts(self):
        return [self.start, np.array([2.0])] if self.both else [self.start]

    @property
    def bounds(self):
        return np.array([(-3.0, 3.0)])

    def covariance(self, shape):
        return np.diag(self.variances(shape[0])) + 1e-12 * np.eye(2)

    def pullback(self, shape, pull):
        slopes = -18 * (shape[0] + np.array([2.0, -2.0])) * self.variances(shape[0])
        return np.array([np.diagonal(pull) @ slopes])

    def variances(self, x):
        return np.exp(-9 * (x + np.array([2.0, -2.0])) ** 2)


SECOND = quadratic_of(np.eye(2), np.array([0.01, 3.0]))
"""Two weights that are observed, of which the second is large."""


def test_a_search_from_every_start_finds_what_one_from_a_bad_start_does_not():
    weights, alone = (GaussianWeights(Bumpy(both=both)) for both in (True, False))
    low = weights.infer(SECOND, np.array([-2.0]), 0.1).hyperparameters
    better = weights.search_anew(SECOND, low, 0.1)
    assert better.log_evidence > low.log_evidence + 10
    assert better.shape[0] > 0
    assert weights.search_anew(SECOND, better, 0.1) is None
    assert alone.search_anew(SECOND, low, 0.1) is None, "there is one start"


def test_without_weights_the_evidence_is_that_of_the_least_amplitude(data):
    noise = np.sqrt((data.squares + data.targets @ data.targets) / data.num_free)
    at = evidence_of_scales(data, prior(np.zeros(1)))
    assert data.log_evidence_without == pytest.approx(at(1e-7 * noise, noise))
