"""What a fit says of a default that its data were too few to test."""

import jax
import numpy as np
import pytest

from pinav.fitting import Cause
from pinav.fitting.environments.catalogue import build
from pinav.learning import account
from pinav.learning.account import (
    ASSUMED_POTENTIAL,
    assumed_potential,
    confirm_outcome,
    likely_cause,
)
from pinav.learning.plan import plan_fit
from pinav.scenarios import scenario
from pinav.trajectories import simulate


@pytest.fixture(scope="module")
def plans():
    system = scenario("swirl", count=1)
    data = simulate(system, key=jax.random.key(0))
    return [plan_fit(system, data, model=model) for model in (None, "kernel-potential")]


@pytest.mark.parametrize(
    ("asked", "rotation", "said"),
    [(0, np.nan, True), (0, -3.0, False), (1, np.nan, False)],
)
def test_a_potential_that_nothing_tested_is_called_assumed(
    plans, asked, rotation, said
):
    plan = plans[asked]
    model = build(plan.choice, plan.system.swimmer, plan.summary)
    expected = (ASSUMED_POTENTIAL,) if said else ()
    assert assumed_potential(plan, model, rotation) == expected


def test_rollouts_confirm_that_a_fit_converged_or_say_the_likely_cause(monkeypatch):
    truth = scenario("paper")
    data = simulate(truth)
    monkeypatch.setattr(account, "diagnose", lambda model, data: Cause.CHAOS)
    far, near = {"total": 0.5}, {"total": 1e-6}
    model = truth.true_swimmer
    (sentence,) = likely_cause(data, model, "stalled", far)
    assert sentence.startswith("The likely cause of the failure: the motion is chaotic")
    assert likely_cause(data, model, "converged", far) == ()
    assert likely_cause(data, model, "stalled", near) == ()
    assert confirm_outcome("converged", 1e-9, data, {"total": 0.5}) == "stalled"
    assert confirm_outcome("converged", 1e-9, data, {"total": 1e-5}) == "converged"
    assert confirm_outcome("misfit", 1e-9, data, {"total": 0.5}) == "misfit"
