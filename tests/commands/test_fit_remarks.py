"""What a fit says of a default that its data were too few to test."""

import jax
import numpy as np
import pytest
from pinav.commands.fit.plan import plan_fit
from pinav.commands.fit.remarks import ASSUMED_POTENTIAL, assumed_potential

from pinav.commands.fit.settings import FitSettings
from pinav.fitting.environments.catalogue import build
from pinav.scenarios import scenario
from pinav.trajectories import simulate


@pytest.fixture(scope="module")
def plans():
    system = scenario("swirl", count=1)
    data = simulate(system, key=jax.random.key(0))
    return [
        plan_fit(FitSettings(model=model), system, data)
        for model in (None, "kernel-potential")
    ]


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
