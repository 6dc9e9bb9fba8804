"""Noisy crossings of the barrier: force errors and bands, over seeds of the noise."""

import equinox as eqx
import jax
import numpy as np
import pytest

from pinav.evaluation import field_map, force_errors
from pinav.fitting import BayesOutcome, fit_bayes, kernel_environment
from pinav.learned import KernelForce, KernelPotential
from pinav.scenarios import barrier_crossings
from pinav.trajectories import Trajectories, simulate

SEEDS = (*range(5), *range(100, 105))
LIMITS = (-2.0, 12.0, -2.0, 12.0)


def nothing(model):
    return ()


def damping_and_gain(model):
    return model.drag.damping, model.propulsion.gain


CASES = {
    "kernel potential": (KernelPotential, 4, nothing),
    "kernel force": (KernelForce, 4, nothing),
    "positions only": (KernelPotential, 2, nothing),
    "constants learned": (KernelPotential, 4, damping_and_gain),
}
BARS = {
    "kernel potential": 0.018,
    "kernel force": 0.035,
    "positions only": 0.020,
    "constants learned": 0.025,
}
"""Median of the relative force error on visited ground."""


@pytest.fixture(scope="module", autouse=True)
def double_precision():
    """Simulation and scores need it."""
    with jax.enable_x64(new_val=True):
        yield


def observe(scenario, seed, columns):
    data = simulate(scenario, key=jax.random.key(seed))
    observed = np.broadcast_to(np.arange(4) < columns, data.states.shape)
    return Trajectories.from_arrays(
        list(data.times), list(data.states), channels=data.channels, observed=observed
    )


def row(name, seed):
    """Errors in three regions, coverage in three rings, and the learned constants."""
    kind, columns, learn = CASES[name]
    scenario = barrier_crossings()
    clean = simulate(eqx.tree_at(lambda s: s.noise, scenario, 0.0))
    data = observe(scenario, seed, columns)
    model = eqx.tree_at(
        lambda s: (s.environment, s.drag.damping, s.propulsion.gain),
        scenario.swimmer,
        (kernel_environment(kind, data), 0.1, 0.0)
        if learn is damping_and_gain
        else (kernel_environment(kind, data), 0.36, 0.034),
    )
    found = fit_bayes(model, data, learn=learn)
    assert found.outcome is BayesOutcome.CONVERGED
    true = field_map(scenario.swimmer.environment, clean, limits=LIMITS)
    learned = field_map(found.model.environment, clean, limits=LIMITS)
    points = np.stack(np.meshgrid(true.x, true.y), axis=-1).reshape(-1, 2)
    sd = found.posterior.force_sd(points).reshape(true.force.shape)
    inside = np.abs(learned.force - true.force) < 1.96 * sd
    visited, near = true.distance <= 0.35, true.distance <= 1.0
    rings = (visited, near & ~visited, ~near)
    constants = [estimate.value for _, estimate in sorted(found.constants.items())]
    return [
        *force_errors(learned, true).values(),
        *(inside[ring].mean() for ring in rings),
        *constants,
    ]


@pytest.fixture(scope="module", params=CASES)
def table(request):
    rows = np.array([row(request.param, seed) for seed in SEEDS])
    print(f"\n{request.param}: visited near everywhere %, band on visited near rest %")
    for seed, values in zip(SEEDS, rows, strict=True):
        print(seed, np.round(100 * values, 3))
    print("median", np.round(100 * np.median(rows, axis=0), 3))
    return request.param, rows


@pytest.mark.parametrize("draws", [slice(0, 5), slice(5, 10)], ids=["0-4", "100-104"])
def test_force_error_on_visited_ground(table, draws):
    name, rows = table
    assert np.median(rows[draws, 0]) <= BARS[name]


@pytest.mark.xfail(
    reason="the bands are too narrow with four states: docs/fitting.md", strict=False
)
@pytest.mark.parametrize("draws", [slice(0, 5), slice(5, 10)], ids=["0-4", "100-104"])
def test_the_band_covers(table, draws):
    _, rows = table
    visited, near, rest = rows[draws, 3:6].mean(axis=0)
    assert visited >= 0.88
    assert near >= 0.88
    assert rest >= 0.80


def test_constants_are_within_one_percent(table):
    name, rows = table
    if name == "constants learned":
        damping, gain = np.median(rows[:, 6:], axis=0)
        assert damping == pytest.approx(0.36, rel=0.01)
        assert gain == pytest.approx(0.034, rel=0.01)
