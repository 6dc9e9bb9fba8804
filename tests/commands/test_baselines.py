"""Baselines in the tables, and runs whose kernels were refined."""

import importlib.util

import jax
import numpy as np
import pytest

from pinav.commands.evaluate.job import evaluate
from pinav.commands.study.job import study
from pinav.commands.study.settings import StudySettings
from pinav.commands.study.stochastic_force_inference import infer_force
from pinav.commands.sweep import Sweep
from pinav.errors import FitError
from pinav.evaluation import field_map, force_errors
from pinav.fitting import Refinement
from pinav.fitting.environments.catalogue import build
from pinav.fitting.environments.choice import ModelChoice
from pinav.fitting.environments.summary import summarise_for
from pinav.learning.learned import ModelHeader, build_model
from pinav.runs import RunFolder
from pinav.scenarios import scenario
from pinav.sweeps import InThisProcess
from pinav.trajectories import simulate

MODELS = ("kernel-potential", "kernel-force", "kernel-mixture", "kernel-potential-time")


@pytest.fixture(scope="module")
def crossings():
    made = scenario("barrier-crossings")
    return made, simulate(made, key=jax.random.key(0))


@pytest.mark.parametrize("name", MODELS)
def test_a_model_file_says_where_the_finer_kernels_are(name, crossings):
    known, data = crossings
    choice = ModelChoice(name)
    summary = summarise_for(choice, data)
    start = build(choice, known.swimmer, summary).environment
    finer = Refinement(factor=2.0, max_weights=10**5).finer(start, data)
    header = ModelHeader(choice, summary.with_kernels_of(finer))
    built = jax.tree.leaves(build_model(header, known).environment)
    for own, expected in zip(built, jax.tree.leaves(finer), strict=True):
        np.testing.assert_allclose(own, expected)


def test_models_without_kernels_keep_their_summary(crossings):
    known, data = crossings
    choice = ModelChoice("neural-force")
    summary = summarise_for(choice, data)
    network = build(choice, known.swimmer, summary).environment
    assert summary.with_kernels_of(network) is summary


@pytest.mark.slow
def test_an_evaluation_has_physics_alone_beside_its_models(tiny_fit):
    run, data = tiny_fit
    with jax.numpy_dtype_promotion("standard"):
        metrics = evaluate(run, data)
    assert metrics.force is not None
    for table in (metrics.rmse, metrics.rollouts, metrics.force):
        assert list(table) == ["model", "physics-only"]
    for region in metrics.force["physics-only"].values():
        assert region.error == pytest.approx(1.0)
        assert region.cosine is None


def without_sfi(monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda n, *a: None if n == "SFI" else find(n, *a)
    )


def test_a_study_says_why_another_tool_has_no_row(monkeypatch, tmp_path):
    without_sfi(monkeypatch)
    folder = RunFolder.create(
        tmp_path / "run", {"run": {"command": "study"}}, overwrite=False
    )
    settings = StudySettings(models=("sfi",), counts=(1,), held_out=2)
    sweep = Sweep(folder, InThisProcess())
    (row,) = study("data-efficiency", "barrier-crossings", settings, sweep).rows
    assert row.outcome == (
        "failed: StochasticForceInference is not installed; pip install 'pinav[peers]'"
    )
    assert row.rollouts_median is None


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
