"""Which law is behind a learned force: synthetic data of known truth."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav.analysis import Verdict, discover
from pinav.analysis.discovery.laws import LawForce
from pinav.analysis.discovery.learned_fit import laplace_posterior
from pinav.analysis.discovery.potentials import GAUSSIAN
from pinav.analysis.discovery.rotations import ROTATIONS
from pinav.dynamics import FixedStep, Swimmer
from pinav.fitting import TrajectoryLoss, curriculum, fit, fit_bayes, kernel_environment
from pinav.fitting.environments.kernels import WITHOUT_PRIOR
from pinav.forces import AbstractForce, GaussianBarrier, KernelForce, KernelPotential
from pinav.scenarios import barrier_crossings, paper
from pinav.trajectories import Trajectories, simulate

TRUTH = np.array([5.25, 5.0, 5.0, 2.9])
"""Height, centre and width of the barrier."""


@pytest.fixture(scope="module", autouse=True)
def double_precision():
    """Simulation and scores need it."""
    with jax.enable_x64(new_val=True):
        yield


class ThreeHills(AbstractForce):
    """Three Gaussian hills: more than any law of the library has."""

    def __call__(self, t, x, v):
        places = ((3.0, 3.5), (6.5, 4.0), (4.5, 7.0))
        hills = [GaussianBarrier(height=3.0, center=list(c), width=1.3) for c in places]
        return sum((hill(t, x, v) for hill in hills), jnp.zeros_like(x))


def observe(environment, seed, *, columns=4, trajectories=8, samples=201):
    """Noisy crossings of a given force, and the swimmer without it."""
    scenario = barrier_crossings()
    scenario = eqx.tree_at(
        lambda s: (s.environment, s.starts, s.times),
        scenario,
        (environment, scenario.starts[:trajectories], scenario.times[:samples]),
    )
    data = simulate(scenario, key=jax.random.key(seed))
    observed = np.broadcast_to(np.arange(4) < columns, data.states.shape)
    return scenario.truth, Trajectories.from_arrays(
        list(data.times), list(data.states), channels=data.channels, observed=observed
    )


def discovered(environment, seed, *, kind: Any = KernelPotential, **options):
    known, data = observe(environment, seed, **options)
    model = known.with_environment(kernel_environment(kind, data))
    assert isinstance(model, Swimmer)
    found = discover(fit_bayes(model, data).posterior, data)
    print(environment, seed, found.verdict, found.central)
    for c in found.candidates:
        print("  ", c.name, round(c.delta_bic, 2), c.outcome, c.fits)
    for own in found.best.constants:
        print("    ", own.name, own.value, own.sd, own.identifiable)
    return found


def test_barrier_from_noisy_positions_over_five_seeds():
    inside = 0
    for seed in range(5):
        found = discovered(paper().true_swimmer.environment, seed, columns=2)
        (gaussian,) = (c for c in found.candidates if c.law is GAUSSIAN)
        assert gaussian.delta_bic < 6.0
        values = np.array([own.value for own in gaussian.constants])
        assert np.all(np.abs(values / TRUTH - 1.0)[[0, 3]] < 0.01)
        assert np.linalg.norm((values - TRUTH)[1:3]) < 0.02
        inside += all(
            own.low < true < own.high
            for own, true in zip(gaussian.constants, TRUTH, strict=True)
        )
    assert inside >= 4


def test_barrier_from_the_papers_single_trajectory():
    scenario = paper()
    data = simulate(scenario)
    model = eqx.tree_at(
        lambda m: m.environment,
        scenario.truth,
        kernel_environment(KernelPotential, data, WITHOUT_PRIOR),
    )
    fitted = fit(
        model,
        data,
        curriculum(data),
        trainable=lambda m: m.environment.weights,
        objective=TrajectoryLoss(FixedStep(substeps=2)),
        dtype=jnp.float64,
    ).model
    assert isinstance(fitted, Swimmer)
    posterior = laplace_posterior(fitted, data, lambda m: m.environment.weights)
    best = discover(posterior, data).best
    assert best.law is GAUSSIAN
    values = np.array([own.value for own in best.constants])
    np.testing.assert_allclose(values, TRUTH, rtol=1e-3)


@pytest.mark.parametrize("seed", range(2))
def test_rotational_term_is_found(seed):
    swirl = LawForce(ROTATIONS[0], jnp.array([0.15, 5.0, 5.0, 2.5]))
    truth = paper().true_swimmer.environment + swirl
    found = discovered(truth, seed, kind=KernelForce)
    assert "swirl" in found.best.name
    assert found.best.fits
    assert found.central.verdict.value == "not central"


def test_says_that_no_law_fits():
    found = discovered(ThreeHills(), 0)
    assert found.verdict is Verdict.NO_LAW_FITS


def test_few_data_identify_nothing():
    environment = paper().true_swimmer.environment
    found = discovered(environment, 0, columns=2, trajectories=1, samples=15)
    assert found.verdict is Verdict.NOT_IDENTIFIABLE
