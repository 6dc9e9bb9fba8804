"""Baselines in the tables, and runs whose kernels were refined."""

import jax
import numpy as np
import pytest

from pinav.evaluation import evaluate
from pinav.fitting import Refinement
from pinav.fitting.environments.catalogue import build
from pinav.fitting.environments.summary import ModelChoice, summarise_for
from pinav.learning.learned import Learned, ModelHeader, build_model
from pinav.scenarios import scenario
from pinav.trajectories import load, simulate

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
        scores = evaluate(Learned.open(run), load(data))
    for table in (scores.rmse, scores.rollouts, scores.force):
        assert list(table) == ["model", "physics-only"]
    for region in scores.force["physics-only"].values():
        assert region.error == pytest.approx(1.0)
        assert np.isnan(region.cosine)
