"""`pinav.learn`: a table becomes a fit, which a folder keeps and gives back."""

import dataclasses

import jax
import numpy as np
import pandas as pd
import pytest
from tests.fitted_runs import crossings

from pinav.codec import encode
from pinav.errors import FitError, InputError
from pinav.fitting import Outcome
from pinav.learning import learn as learning
from pinav.learning.learn import infer, learn, open_run
from pinav.learning.learned import POSTERIOR
from pinav.learning.plan import plan_fit
from pinav.learning.recipes import Bayes
from pinav.runs import RunFolder
from pinav.scenarios import barrier_crossings
from pinav.trajectories import simulate

PLACES = [[5.0, 5.0], [4.0, 6.5]]


@pytest.fixture(scope="module")
def learned():
    table = pd.DataFrame(crossings(61).only(("x", "y")).to_table())
    seen = []
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        fit = learn(
            "barrier-crossings",
            table,
            recipe=Bayes(structure="free"),
            train=("damping",),
            on_progress=seen.append,
        )
    assert [step.done for step in seen] == list(range(1, len(seen) + 1))
    return fit


def test_a_table_of_pandas_gives_force_constants_and_remarks(learned):
    assert learned.force(PLACES).shape == (2, 2)
    damping = learned.constants["damping"]
    assert damping.low < 0.36 < damping.high
    assert learned.outcome == "converged"
    assert any("assumed conservative" in remark for remark in learned.remarks)
    with pytest.raises(InputError, match="was not saved"):
        _ = learned.folder


def test_what_was_saved_is_opened_again(learned, tmp_path):
    kept = learned.save(tmp_path / "run")
    again = open_run(tmp_path / "run")
    np.testing.assert_array_equal(again.force(PLACES), learned.force(PLACES))
    sd = [fit.posterior.force_sd(PLACES) for fit in (again, kept)]
    np.testing.assert_array_equal(*sd)
    assert again.constants == learned.constants
    first, second = (encode(fit.findings) for fit in (again, learned))
    assert first.document == second.document
    for name, array in first.arrays.items():
        np.testing.assert_array_equal(array, second.arrays[name])
    with pytest.raises(InputError, match="already holds a run"):
        learned.save(tmp_path / "run")


def test_the_posterior_of_another_fit_is_refused(learned, tmp_path):
    learned.save(tmp_path / "run")
    folder = RunFolder.open(tmp_path / "run")
    mean, covariance = learned.evidence.mean[1:], learned.evidence.covariance[1:, 1:]
    evidence = dataclasses.replace(learned.evidence, mean=mean, covariance=covariance)
    folder.store(POSTERIOR, evidence)
    with pytest.raises(InputError, match=r"posterior.json is not of the same fit"):
        open_run(tmp_path / "run")


@pytest.mark.parametrize(("model", "says"), [("potential", True), ("force", False)])
def test_a_potential_that_diverged_names_the_model_that_turns(monkeypatch, model, says):
    """A vortex, fitted by a potential, ends so."""

    class Diverged:
        outcome = Outcome.DIVERGED

    monkeypatch.setattr(learning.fitting, "fit_bayes", lambda *_, **__: Diverged)
    truth = barrier_crossings(jax.random.key(0))
    data = simulate(truth, key=jax.random.key(0))
    recipe = Bayes(structure="free")
    plan = plan_fit(truth, data, model=f"kernel-{model}", recipe=recipe)
    with pytest.raises(FitError, match="the fit diverged: the states depart") as error:
        infer(plan)
    assert ("choose --model kernel-mixture" in str(error.value)) == says
