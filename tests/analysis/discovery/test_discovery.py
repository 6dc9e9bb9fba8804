import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from tests.fitted_runs import crossing_system
from tests.fitting.problems import observing

from pinav.analysis import Verdict, discover_law
from pinav.analysis.discovery.discovery import estimates
from pinav.analysis.discovery.refit import (
    LearnedOnPaths,
    Refit,
    laplace_posterior,
    refit,
)
from pinav.dynamics import Adaptive, NeuralDynamics, rollout
from pinav.errors import FitError, InputError
from pinav.fitting import Outcome
from pinav.fitting.engine.local_model import known_model
from pinav.forces import GaussianBarrier
from pinav.forces.geometries import Center
from pinav.forces.law_force import LawForce
from pinav.forces.law_library import CONSTANT_FORCE, GAUSSIAN, HARMONIC
from pinav.forces.laws import ProfileLaw
from pinav.forces.profiles import Lorentzian
from pinav.systems import Observation
from pinav.trajectories import simulate, smooth_states
from pinav.units import with_order

TRUTH = np.array([5.25, 5.0, 5.0, 2.9])
LORENTZIAN = ProfileLaw(Lorentzian(), Center())


def environment(model):
    return model.environment


@pytest.fixture(scope="module")
def crossings():
    """Four short noisy crossings of which the positions are seen, and the truth."""
    scenario = crossing_system(4, 61, observation=Observation(0.01))
    data = simulate(scenario, key=jax.random.key(1))
    seen = np.broadcast_to(np.arange(4) < 2, data.states.shape)
    return scenario.truth, observing(data, seen)


@pytest.fixture(scope="module")
def posterior(crossings):
    return laplace_posterior(*crossings, environment)


@pytest.fixture(scope="module")
def found(crossings, posterior):
    candidates = (GAUSSIAN, LORENTZIAN, HARMONIC)
    return discover_law(posterior, crossings[1], laws=candidates, refits=2)


def test_the_true_law_comes_first_with_intervals(found):
    assert found.verdict is Verdict.IDENTIFIED
    assert found.best.law == GAUSSIAN
    assert found.close == (found.best,)
    for own, true in zip(found.best.constants, TRUTH, strict=True):
        assert own.low < own.value < own.high
        assert abs(own.value - true) < 4 * own.sd
        assert own.identifiable
    assert found.best.noise == pytest.approx(0.01, rel=0.2)


def test_a_wrong_law_does_not_fit_and_stands_below(found):
    best, other = found.candidates
    assert best.delta_bic == 0.0
    assert other.delta_bic > 6.0
    assert not other.fits
    criteria = [bic for _, bic in found.screened]
    assert criteria == sorted(criteria)


def test_no_law_fits_where_none_can(crossings, posterior):
    found = discover_law(posterior, crossings[1], laws=(CONSTANT_FORCE,))
    assert found.verdict is Verdict.NO_LAW_FITS


def test_refit_is_the_least_squares_of_rollouts(crossings, posterior, found):
    """Independent check: no neighbouring rollouts have a smaller sum of squares."""
    truth, data = crossings
    learned = LearnedOnPaths.of(posterior, data)
    result = refit(GAUSSIAN, TRUTH * 1.05, truth, learned)
    assert result.outcome is Outcome.CONVERGED
    best = [own.value for own in found.best.constants]
    sd = np.array([own.sd for own in found.best.constants])
    assert np.all(np.abs(result.constants - best) < 0.05 * sd)

    def residuals(constants, starts):
        model = eqx.tree_at(environment, truth, LawForce(GAUSSIAN, constants))

        def solve(y0, ts):
            return rollout(model, y0, ts, solver=Adaptive()).ys

        return (jax.vmap(solve)(starts, data.times) - data.states)[..., :2].ravel()

    split = len(best)
    function = eqx.filter_jit(lambda p: residuals(p[:split], p[split:].reshape(-1, 4)))
    start = np.concatenate([result.constants, smooth_states(data)[:, 0].ravel()])
    oracle = scipy.optimize.least_squares(
        lambda p: np.asarray(function(jnp.asarray(p))), start, x_scale="jac"
    )
    assert 2 * oracle.cost == pytest.approx(result.squares, rel=1e-5)
    inverse = np.linalg.inv(oracle.jac.T @ oracle.jac)[:split, :split]
    expected = np.sqrt(np.diag(inverse) * result.noise**2)
    np.testing.assert_allclose(np.sqrt(np.diag(result.covariance)), expected, rtol=0.02)


def refit_with(constants, sd):
    return Refit(
        law=GAUSSIAN,
        constants=np.asarray(constants, float),
        covariance=np.diag(np.square(sd)),
        squares=1.0,
        noise=1.0,
        num_residuals=10,
        outcome=Outcome.CONVERGED,
    )


UNITS = {"x": "um", "t": "s"}


@pytest.mark.parametrize(
    ("order", "force", "height"),
    [(2, "1", "um² s⁻²"), (1, "1", "um² s⁻¹"), (1, "pN", "pN um"), (1, "?", "?")],
)
def test_constants_of_a_law_have_the_units_of_the_data(order, force, height):
    units = with_order(UNITS, order, force)
    rows = estimates(refit_with(TRUTH, [1.0] * 4), 10.0, units)
    assert [row.unit for row in rows] == [height, "um", "um", "um"]


def test_wide_intervals_are_not_identifiable():
    rows = estimates(refit_with(TRUTH, [3.0, 0.1, np.inf, 0.1]), 10.0, UNITS)
    assert [own.identifiable for own in rows] == [False, True, False, True]
    assert rows[1].low == pytest.approx(5.0 - 0.196)


def test_singular_directions_have_infinite_intervals(crossings, posterior):
    """Far from the data a barrier is felt as nothing: none of it is determined."""
    truth, data = crossings
    learned = LearnedOnPaths.of(posterior, data)
    far = np.array([1e-3, 90.0, 90.0, 1.0])
    result = refit(GAUSSIAN, far, truth, learned)
    assert not any(
        own.identifiable for own in estimates(result, learned.extent, UNITS)[1:]
    )


def test_bic_counts_constants():
    result = refit_with(TRUTH, np.ones(4))
    expected = 10 * np.log(0.1) + 4 * np.log(10)
    assert result.bic == pytest.approx(expected)
    diverged = eqx.tree_at(lambda r: r.squares, result, 0.0)
    assert diverged.bic == np.inf


def test_messages(crossings, posterior):
    truth, data = crossings
    with pytest.raises(InputError, match="one or more candidates and refits"):
        discover_law(posterior, data, refits=0)
    network = eqx.nn.MLP(5, 4, 2, 1, key=jax.random.key(0))
    black_box = NeuralDynamics(network, (0.0,) * 5, (1.0,) * 5)
    wrong = eqx.tree_at(lambda p: p.free, posterior, known_model(black_box))
    with pytest.raises(InputError, match="expected that of a swimmer"):
        discover_law(wrong, data)
    cliff = GaussianBarrier(height=np.inf, center=[5.0, 5.0], width=0.1)
    with pytest.raises(FitError, match="does not explain the trajectories"):
        laplace_posterior(eqx.tree_at(environment, truth, cliff), data, environment)
