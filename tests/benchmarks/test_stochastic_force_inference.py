"""StochasticForceInference as a contestant, where it is installed."""

import importlib.util

import jax
import pytest
from benchmarks.fields.stochastic_force_inference import infer_force

from pinav.errors import FitError
from pinav.evaluation import field_map, force_errors
from pinav.scenarios import scenario
from pinav.trajectories import simulate


@pytest.fixture(scope="module")
def crossings():
    made = scenario("barrier-crossings")
    return made, simulate(made, key=jax.random.key(0))


def without_sfi(monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda n, *a: None if n == "SFI" else find(n, *a)
    )


def test_another_tool_that_is_not_installed_is_named(monkeypatch, crossings):
    without_sfi(monkeypatch)
    with pytest.raises(FitError, match="StochasticForceInference is not installed"):
        infer_force(crossings[0].swimmer, crossings[1], 0.02)


@pytest.mark.slow
@pytest.mark.extras("SFI")
@pytest.mark.filterwarnings("default")  # of the other tool
def test_another_tool_finds_the_force_of_crossings(crossings):
    truth, data = crossings
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        inferred = infer_force(truth.swimmer, data, 0.02)
        true = field_map(truth.environment, data)
        error = force_errors(field_map(inferred.environment, data), true)
    assert error["visited"] < 0.6


def test_another_tool_is_asked_for_swimmers_with_inertia(crossings):
    with pytest.raises(FitError, match="asked for swimmers with inertia"):
        infer_force(scenario("brownian").swimmer, crossings[1], 0.02)
