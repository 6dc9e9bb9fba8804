"""Where a live session changes its mind: each limit on both of its sides."""

import math

import numpy as np
import pytest
from tests.identification.running.test_running_fit import run, small_grid
from tests.live.sessions import HELLO
from tests.rig import Robot

from pinav.identification.running import RunningFit
from pinav.identification.running.forecast import estimate, gain_at
from pinav.live.estimators import DriveEstimator, Intent
from pinav.live.roller_pilot import (
    KNOWN,
    LEAST_PROBES,
    PATIENCE,
    RollerPilot,
)
from pinav.live.safety import Outlook, Reserve
from pinav.live.sources import LineBuffer


@pytest.fixture(scope="module")
def driven():
    """An estimator of a robot in a drift, and where the robot is."""
    robot = Robot(drift=(3.0, -2.0), noise=0.05)
    fit, robot = run(RunningFit.begin(small_grid()), 250, robot)
    fit = fit.after(robot.t, robot.seen(), 0.0, 0.0)
    last = np.array([robot.x, robot.y, robot.t, np.nan])
    return DriveEstimator(fit, last, estimate(fit)), robot


def pilot_to(goal, tolerance=1.0, discs=(), **more):
    probe = np.array([LEAST_PROBES, 0.0])
    return RollerPilot(
        np.array(goal), tolerance, np.array(discs, float).reshape(-1, 3), probe, **more
    )


@pytest.mark.parametrize("angle", np.arange(0.0, 6.2, 0.9))
def test_a_command_and_the_drift_lead_to_the_goal(driven, angle):
    estimator, robot = driven
    here = np.array(estimator.whereabouts(robot.t).position)
    goal = here + 400 * np.array([math.cos(angle), math.sin(angle)])
    _, advice = pilot_to(goal).after(estimator, HELLO, robot.t)
    assert advice.intent is Intent.STEER
    matrix, _ = gain_at(estimator.fit, advice.frequency)
    thrust = matrix @ [math.cos(advice.heading), math.sin(advice.heading)]
    motion = thrust + np.array(estimator.known.drift)
    bearing = math.atan2(*motion[::-1])
    assert abs(math.remainder(bearing - angle, math.tau)) < 0.05
    assert math.isclose(advice.frequency, HELLO.limits.frequency)
    seconds = 400 / np.linalg.norm(thrust)
    assert math.isclose(advice.time_to_go, seconds, rel_tol=0.15)


def test_a_robot_slows_down_before_the_goal(driven):
    estimator, robot = driven
    here = np.array(estimator.whereabouts(robot.t).position)
    fast = HELLO.limits.frequency
    speed = np.linalg.norm(gain_at(estimator.fit, fast)[0], 2)
    reach = estimator.known.delay + HELLO.step
    _, far = pilot_to(here + [2.5 * speed * reach, 0]).after(estimator, HELLO, robot.t)
    _, near = pilot_to(here + [1.0 * speed * reach, 0]).after(estimator, HELLO, robot.t)
    assert far.frequency == fast
    assert 0.25 * fast < near.frequency < 0.75 * fast


def test_a_pilot_probes_until_it_knows_and_gives_up_after_stalls(driven):
    estimator, robot = driven
    here = np.array(estimator.whereabouts(robot.t).position)
    goal = here + [500.0, 0.0]

    def intent(pilot, time=robot.t):
        return pilot.after(estimator, HELLO, time)[1].intent

    few = np.array([LEAST_PROBES - 1, robot.t])
    assert intent(RollerPilot(goal, 1.0, np.zeros((0, 3)), few)) is Intent.PROBE
    assert intent(pilot_to(here + [0.9, 0])) is Intent.ARRIVED
    assert intent(pilot_to(here + [1.4, 0])) is not Intent.ARRIVED
    assert estimator.known.gain_sd < KNOWN * estimator.known.gain
    vague = DriveEstimator(
        estimator.fit,
        estimator.last,
        type(estimator.known)(0.3, 1.0, 1.01 * KNOWN, 0.0, (0.0, 0.0)),
    )
    assert pilot_to(goal).after(vague, HELLO, robot.t)[1].intent is Intent.PROBE
    best = np.array([500.0, robot.t - PATIENCE + 0.1])
    assert intent(pilot_to(goal, best=best)) is Intent.STEER
    best = np.array([500.0, robot.t - PATIENCE - 0.1])
    assert intent(pilot_to(goal, best=best)) is Intent.STALLED
    stalled, _ = pilot_to(goal, best=best).after(estimator, HELLO, robot.t)
    assert stalled.stalls == 1
    assert intent(pilot_to(goal, best=best, stalls=3)) is Intent.GIVE_UP


@pytest.mark.parametrize("gap", range(8))
def test_the_only_way_out_of_a_ring_is_found(driven, gap):
    estimator, robot = driven
    here = np.array(estimator.whereabouts(robot.t).position)
    wanted = np.array([3.0, 0.4])
    opening = wanted[1] + gap * math.tau / 8
    # The motion is turned against the heading by the offset of the drive.
    turns = opening + estimator.known.offset + np.arange(3, 14) * math.tau / 16
    ring = here + 34 * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    discs = np.column_stack([ring, np.full(len(ring), 13.0)])
    view = Outlook(estimator.fit, robot.t, 0.1, here, 0.05, 3.0, discs)
    verdict = view.judge(wanted, Reserve())
    clear = view.clearances(verdict.order, verdict.order, 2.0).min()
    assert clear >= 0
    if verdict.order[0] == 3.0:
        apart = math.remainder(verdict.order[1] - opening, math.tau)
        assert abs(apart) < math.tau / 8 + 1e-9
    assert verdict.changed or gap in (0, 1, 7)


def test_lines_end_with_either_kind_of_break():
    buffer, lines = LineBuffer().after(b"a\r\nb\n\nc")
    assert lines == [b"a", b"b"]
    assert buffer.after(b"d\n")[1] == [b"cd"]
