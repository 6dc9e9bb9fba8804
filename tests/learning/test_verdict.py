"""The verdict of a fit: which reason comes first, and its sentence."""

import jax
import numpy as np
import pytest
from tests.fitted_runs import trap_system

from pinav import learn, simulate
from pinav.fitting.checks.departures import Contradiction
from pinav.learning.verdict import CREDIBLE, Standing, judge

THRUST = Contradiction("thrust", 190.0, "the thrust is 0.5 times the stated one")
OUTLIER = Contradiction("outlier", 300.0, "x of trajectory 1 in row 20 lies far off")
DRAG = Contradiction("drag", CREDIBLE - 0.1, "the drag is 1.1 times the stated one")


def verdict(outcome="converged", against=(DRAG,), copied=None, **options):
    checks = {"is_adequate": True, "has_bands": True} | options
    return judge(outcome, tuple(against), copied, **checks)


def test_a_fit_that_nothing_contradicts_is_trusted_with_the_number():
    told = verdict()
    assert told.is_trusted
    assert "none of 1 departures" in told.says
    assert "differs by 5.9 nats" in told.says


@pytest.mark.parametrize(
    ("options", "standing", "words"),
    [
        ({"against": (THRUST,)}, Standing.CONTRADICTS, "0.5 times the stated one (190"),
        ({"against": (OUTLIER,)}, Standing.PREDICTS, "row 20"),
        ({"copied": (0, 4)}, Standing.PREDICTS, "trajectory 4 copies trajectory 0"),
        ({"outcome": "stalled"}, Standing.UNCONVERGED, "ended stalled"),
        ({"support": 2.0}, Standing.UNSUPPORTED, "known physics alone is 2.0 nats"),
        ({"is_adequate": False}, Standing.PREDICTS, "not independent noise"),
        ({"has_bands": False}, Standing.PREDICTS, "without a posterior"),
    ],
)
def test_a_reason_is_named_first(options, standing, words):
    told = verdict(**options)
    assert told.standing is standing
    assert told.says.startswith(f"Verdict: {standing}: ")
    assert words in told.says
    forbidden = (Standing.CONTRADICTS, Standing.UNSUPPORTED)
    assert told.forbids_steering == (standing in forbidden)


def test_a_contradiction_comes_before_a_fit_that_did_not_converge():
    told = verdict(outcome="stalled", against=(THRUST,))
    assert told.standing is Standing.CONTRADICTS


def test_a_fit_without_checks_says_so():
    assert "no check of the data contradicts" in verdict(against=()).says


def test_particles_in_one_stiff_trap_are_no_copies():
    """Their distance is below the diffusion of a unit of time, which is no length."""
    system = trap_system(
        stiffness=2000.0, thermal_energy=1.0, times=np.linspace(0.0, 0.2, 201)
    )
    data = simulate(system, key=jax.random.key(0))
    assert "copies" not in learn(system, data).verdict.says
