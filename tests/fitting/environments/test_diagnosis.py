import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from tests.fitting.problems import STATES, beginning, follow

from pinav.dynamics import Swimmer
from pinav.fitting.environments.diagnosis import (
    NOISES,
    Cause,
    diagnose,
    largest_growth,
    regression_evidence,
)
from pinav.forces import (
    ConstantForce,
    GaussianBarrier,
    KernelForce,
    KernelPotential,
    LinearDrag,
    LinearForce,
    SumForce,
    gaussian_swirl,
)
from pinav.trajectories import Trajectories

BARRIER = GaussianBarrier(3.0, [2.0, 0.3], 1.5)
TRUTH = Swimmer(ConstantForce([0.0, 0.05]), LinearDrag(0.3), BARRIER)
UNTRAINED = KernelPotential.with_zero_weights(np.zeros((1, 2)), 1.0)


def start(angle: float) -> np.ndarray:
    """From a ring towards the barrier; paths cross, and some turn back."""
    inwards = np.array([np.cos(angle), np.sin(angle)])
    place = np.array([2.0, 0.3]) - 4.0 * inwards + 0.3 * inwards[::-1]
    return np.concatenate([place, (2.5 + 0.4 * angle) * inwards])


def observe(truth: Swimmer, interval: float = 0.05) -> Trajectories:
    times = np.arange(0.0, 8.0, interval)
    return follow(truth, [start(angle) for angle in range(6)], [times] * 6)


def cause_of(truth: Swimmer, known: Swimmer, interval: float = 0.05) -> Cause | None:
    return diagnose(known.with_environment(UNTRAINED), observe(truth, interval))


@pytest.mark.slow
def test_a_field_that_is_there_and_was_not_found_is_a_failed_search():
    assert cause_of(TRUTH, TRUTH) is Cause.SEARCH


def test_a_wrong_drag_is_wrong_physics():
    known = eqx.tree_at(lambda m: m.drag.damping, TRUTH, 0.45)
    assert cause_of(TRUTH, known) is Cause.PHYSICS


def test_a_swirl_has_no_potential_but_a_field():
    swirl = SumForce((BARRIER, gaussian_swirl(2.0, [2.0, 0.3], 1.5)))
    truth = TRUTH.with_environment(swirl)
    seen, free = observe(truth), KernelForce.with_zero_weights(np.zeros((1, 2)), 1.0)
    for untrained, cause in ((UNTRAINED, Cause.NO_POTENTIAL), (free, Cause.SEARCH)):
        assert diagnose(truth.with_environment(untrained), seen) is cause


@pytest.mark.slow
def test_a_narrow_hill_between_two_samples_asks_for_shorter_intervals():
    narrow = TRUTH.with_environment(GaussianBarrier(1.0, [0.0, 0.3], 0.12))
    assert cause_of(narrow, narrow, 0.2) is Cause.SAMPLES


def test_differences_on_a_saddle_grow_exponentially():
    saddle = LinearForce(jnp.diag(jnp.array([4.0, -4.0])), [0.0, 0.0])
    model = Swimmer(ConstantForce([0.0, 0.0]), LinearDrag(0.0), saddle)
    times, still = np.linspace(0.0, 3.0, 301), np.zeros((301, 4))
    rest = Trajectories.from_arrays(times, still, channels=STATES)
    # Of (x, vx / 2) the growth is exp(2 t); in x and vx the norm is that of this
    # matrix of hyperbolic functions.
    c, s = np.cosh(6.0), np.sinh(6.0)
    exact = np.linalg.norm([[c, 0.5 * s], [2.0 * s, c]], 2)
    assert largest_growth(model, rest) == pytest.approx(exact, rel=1e-6)


def test_too_few_samples_tell_no_cause():
    few = beginning(observe(TRUTH), 5)
    assert diagnose(TRUTH.with_environment(UNTRAINED), few) is None


def test_the_evidence_of_a_regression_is_the_density_of_a_normal_distribution():
    rng = np.random.default_rng(0)
    columns, forces = rng.normal(size=(40, 2, 7)), rng.normal(size=(40, 2))
    rows, y = columns.reshape(80, -1), forces.ravel() / np.sqrt(np.mean(forces**2))
    top = np.sum(rows**2, axis=0).max()
    densities = []
    for noise in NOISES:
        shape = rows @ rows.T + noise * top * np.eye(80)
        scale = y @ np.linalg.solve(shape, y) / 80
        logarithm = np.linalg.slogdet(2.0 * np.pi * scale * shape)[1]
        squares = y @ np.linalg.solve(scale * shape, y)
        densities.append(-0.5 * (logarithm + squares) / 80)
    plain = regression_evidence(columns, forces)
    assert plain == pytest.approx(max(densities))
    assert plain == pytest.approx(-1.4, abs=0.2)
    assert regression_evidence(columns, 100.0 * forces) == pytest.approx(plain)
    assert regression_evidence(columns, columns @ rng.normal(size=7)) > 5.0
