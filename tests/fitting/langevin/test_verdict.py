"""What increments say before a fit."""

import re

import numpy as np
import pytest

from pinav.fitting import judge_increments
from pinav.fitting.engine.posterior import Estimate
from pinav.fitting.langevin.checks import (
    LangevinChecks,
    ThinnedDiffusion,
    innovation_correlations,
    thinned_diffusion,
)
from pinav.trajectories import Trajectories

RNG = np.random.default_rng(5)
COUNT, FINE = 6000, 20


def paths(exposure=0.0, error=0.0, rate=0.0):
    """Positions at unit times with D = 1/2: a step has variance one."""
    x, path = np.zeros(2), []
    for kick in RNG.normal(size=(COUNT * FINE, 2)) / np.sqrt(FINE):
        x = x * (1 - rate / FINE) + kick
        path.append(x)
    kept = max(1, round(exposure * FINE))
    seen = np.reshape(path, (COUNT, FINE, 2))[:, -kept:].mean(axis=1)
    seen += error * RNG.normal(size=seen.shape)
    return Trajectories.from_arrays(np.arange(COUNT * 1.0), seen, channels=("x", "y"))


def test_exact_positions_are_said_to_be():
    verdict = judge_increments(paths())
    assert verdict.is_thermal
    assert verdict.is_exact
    assert "without visible blur or error" in verdict.statement


def test_blur_and_error_are_told_apart_by_their_sign():
    blurred = judge_increments(paths(exposure=0.6))
    share = 0.6 / 6
    expected = share / (1 - 2 * share)
    assert blurred.correlations[0] == pytest.approx(expected, abs=0.03)
    assert blurred.bias == pytest.approx(-expected / (0.5 + expected), abs=0.05)
    assert "blurred over 0." in blurred.statement
    erring = judge_increments(paths(error=0.5))
    assert erring.correlations[0] == pytest.approx(-0.25 / 1.5, abs=0.03)
    error = re.search(r"an error of (\S+) of a step", erring.statement)
    assert error is not None
    assert float(error[1]) == pytest.approx(0.5, abs=0.05)
    assert erring.bias > 0


def test_smooth_motion_is_not_thermal():
    times = np.linspace(0, 20, 500)
    states = np.stack([np.sin(times), np.cos(times)], axis=1)
    verdict = judge_increments(
        Trajectories.from_arrays(times, states, channels=("x", "y"))
    )
    assert not verdict.is_thermal
    assert "no thermal motion without inertia" in verdict.statement


def test_steps_long_against_the_relaxation_are_said_to_be():
    verdict = judge_increments(paths(rate=0.6))
    assert verdict.relaxed == pytest.approx(1 - np.exp(-0.6), abs=0.1)
    assert "too long for a drift" in verdict.statement


def test_checks_name_what_fails():
    smooth = np.repeat(RNG.normal(size=(500, 1)), 2, axis=0)
    correlations = innovation_correlations([smooth])
    assert correlations[0, 0] == pytest.approx(0.5, abs=0.1)
    ratio = ThinnedDiffusion(2, (0,), Estimate(1.3, 0.02))
    checks = LangevinChecks(correlations, len(smooth), (ratio,), ())
    assert not checks.is_adequate
    assert "Innovations along axis 0 correlate by +0." in checks.statement
    assert "from every 2 samples is 1.300" in checks.statement
    good = LangevinChecks(0 * correlations, len(smooth), (), ())
    assert good.is_adequate
    assert "The fit explains the increments" in good.statement


def test_thinned_steps_of_diffusion_give_its_diffusion():
    steps = RNG.normal(size=(9000, 2))
    expected = np.full_like(steps, 0.5)
    (first, second) = thinned_diffusion([steps], [expected], ((0,), (1,)), 3)
    for one in (first, second):
        assert abs(one.ratio.value - 1) < 4 * one.ratio.sd
        assert 0.01 < one.ratio.sd < 0.1
    assert thinned_diffusion([steps[:20]], [expected[:20]], ((0, 1),), 2) == ()
