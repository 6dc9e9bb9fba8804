"""Which law is behind a learned force: synthetic data of known truth."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from benchmarks.fields.families import FAMILIES, random_system

from pinav.analysis import Verdict, discover_law
from pinav.analysis.discovery.refit import laplace_posterior
from pinav.dynamics import FixedStep, Swimmer
from pinav.fitting import (
    TrajectoryLoss,
    curriculum,
    fit,
    fit_bayes,
    fit_structured,
    kernel_environment,
)
from pinav.fitting.environments.kernels import KernelGrid
from pinav.forces import AbstractForce, GaussianBarrier, KernelForce, KernelPotential
from pinav.forces.law_force import LawForce
from pinav.forces.law_library import GAUSSIAN, GAUSSIAN_SWIRL, HARMONIC
from pinav.scenarios import barrier_crossings, paper
from pinav.trajectories import Trajectories, simulate

TRUTH = np.array([5.25, 5.0, 5.0, 2.9])
"""Height, centre and width of the barrier."""


@pytest.fixture(scope="module", autouse=True)
def double_precision():
    """Simulation and scores need it."""
    with jax.enable_x64(new_val=True):
        yield


class Hills(AbstractForce):
    """Gaussian hills: with more than three, more than any law of the library has."""

    places: tuple[tuple[float, float], ...]

    def __call__(self, t, x, v):
        hills = [GaussianBarrier(3.0, list(c), 1.3) for c in self.places]
        return sum((hill(t, x, v) for hill in hills), jnp.zeros_like(x))


class RadialHill(AbstractForce):
    """A hill about (5, 5) of a profile that is no law of the library."""

    profile: Callable[[jax.Array], jax.Array] = eqx.field(static=True)
    height: float = 4.0

    def __call__(self, t, x, v):
        def potential(x):
            return self.height * self.profile(jnp.sum((x - 5.0) ** 2))

        return -jax.grad(potential)(x)


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
    found = discover_law(fit_bayes(model, data).posterior, data)
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
        (gaussian,) = (c for c in found.candidates if c.law == GAUSSIAN)
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
        kernel_environment(KernelPotential, data, KernelGrid(10, 1.5, 2.0)),
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
    best = discover_law(posterior, data).best
    assert best.law == GAUSSIAN
    values = np.array([own.value for own in best.constants])
    np.testing.assert_allclose(values, TRUTH, rtol=1e-3)


@pytest.mark.parametrize("seed", range(2))
def test_rotational_term_is_found(seed):
    strength = 0.15 * 2.5**2
    swirl = LawForce(GAUSSIAN_SWIRL, jnp.array([strength, 5.0, 5.0, 2.5]))
    truth = paper().true_swimmer.environment + swirl
    found = discovered(truth, seed, kind=KernelForce)
    assert "swirl" in found.best.name
    assert found.best.fits
    assert found.central.verdict.value == "not central"


THREE = ((3.0, 3.5), (6.5, 4.0), (4.5, 7.0))


def test_three_hills_have_one_law():
    """Their structure is found first: hills of one kind at three places."""
    known, data = observe(Hills(THREE), 0, trajectories=16)
    model = known.with_environment(kernel_environment(KernelPotential, data))
    found = discover_law(fit_structured(model, data).fit.posterior, data)
    assert found.structure == ("obstacles",)
    assert found.best.name == "Gaussian at 3 places"
    assert found.verdict is Verdict.IDENTIFIED


def test_a_sum_of_three_is_found_in_a_free_force():
    swirl = LawForce(GAUSSIAN_SWIRL, jnp.array([1.0, 6.0, 4.0, 1.5]))
    trap = LawForce(HARMONIC, jnp.array([0.05, 5.0, 5.0]))
    truth = paper().true_swimmer.environment + swirl + trap
    found = discovered(truth, 0, kind=KernelForce, trajectories=16)
    assert set(found.best.terms) == {"Gaussian", "Gaussian swirl", "harmonic"}
    assert found.best.fits


def test_says_that_no_law_fits():
    places = (*THREE, (2.0, 6.5), (7.5, 7.0), (5.0, 1.5))
    found = discovered(Hills(places), 0)
    assert found.verdict is Verdict.NO_LAW_FITS


def _cosine(q):
    r = jnp.minimum(jnp.sqrt(q + 1e-20), 5.0)
    return 0.5 * (1 + jnp.cos(jnp.pi * r / 5.0))


PROFILES = {
    "Mexican hat": lambda q: (1 - q / 9) * jnp.exp(-q / 9),
    "two widths": lambda q: 0.6 * jnp.exp(-q / 4) + 0.4 * jnp.exp(-q / 16),
    "fourth power": lambda q: 1 / (1 + q**2 / 30),
    "raised cosine": _cosine,
    "soft exponential": lambda q: jnp.exp(1 - jnp.sqrt(q / 3 + 1)),
    "sinc": lambda q: jnp.sinc(jnp.sqrt(q + 1e-20) / 3.5),
    "squared logistic": lambda q: jax.nn.sigmoid(3 - 1.5 * jnp.sqrt(q + 1e-20)) ** 2,
}
"""Hills of which no law of the library is the formula."""


@pytest.mark.parametrize("name", PROFILES)
def test_no_law_is_claimed_for_a_profile_that_has_none(name):
    known, data = observe(RadialHill(PROFILES[name]), 1, columns=2, trajectories=16)
    model = known.with_environment(kernel_environment(KernelPotential, data))
    fit = fit_structured(model, data).fit
    found = discover_law(fit.posterior, data)
    print(name, found.structure, found.verdict, found.best.name)
    assert found.structure == ("central",)
    assert found.verdict is Verdict.NO_LAW_FITS


@pytest.mark.parametrize(
    "family", ["gaussian", "screened", "lorentzian", "compact", "ring", "hill-wall"]
)
def test_laws_of_a_structured_fit(family):
    """A draw on which nothing was developed; the benchmark `fields` has many more."""
    system = random_system(family, 137)
    data = simulate(system, key=jax.random.key(137)).only(("x", "y"))
    model = system.swimmer.with_environment(kernel_environment(KernelPotential, data))
    found = discover_law(fit_structured(model, data).fit.posterior, data)
    assert found.verdict is Verdict.IDENTIFIED
    assert tuple(sorted(found.best.terms)) == FAMILIES[family].laws


def test_few_data_identify_nothing():
    environment = paper().true_swimmer.environment
    found = discovered(environment, 0, columns=2, trajectories=1, samples=15)
    assert found.verdict is Verdict.NOT_IDENTIFIABLE
