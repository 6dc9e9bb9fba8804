"""Baselines in the tables, and runs whose kernels were refined."""

import jax
import numpy as np
import pytest

from pinav.evaluation import evaluate
from pinav.learning.learned import Learned
from pinav.trajectories import load


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
