"""The pilot against the simulated robot, without processes; discs are not entered."""

import math
from itertools import chain, islice

import jax
import numpy as np
import pytest
from tests.identification.running.test_running_fit import small_grid
from tests.live.sessions import HELLO, frame_line, line, steer
from tests.rig import Robot

from pinav.codec import decode, encode
from pinav.live.estimators import Advice, DriveEstimator, Intent
from pinav.live.messages import Command, EventKind, Mode
from pinav.live.roller_pilot import RollerPilot, _tangent, _way_point
from pinav.live.session import Session

DISC = np.array([[40.0, 10.0, 12.0]])


def estimator():
    from pinav.identification.running import RunningFit

    return DriveEstimator(RunningFit.begin(small_grid()))


def fly(pilot, steps, robot):
    """The path of a robot that a session steers, the session, and its events."""
    session = Session(estimator(), pilot).after(line(HELLO)).session
    path, sessions, events = zip(*islice(steer(session, robot), steps), strict=True)
    return np.array(path), sessions[-1], list(chain(*events))


@pytest.mark.slow
def test_an_unknown_robot_reaches_the_goal_around_a_disc():
    pilot = RollerPilot(np.array([70.0, 20.0]), 3.0, DISC)
    path, session, events = fly(pilot, 300, Robot())
    assert EventKind.ARRIVED in [event.kind for event in events]
    assert np.hypot(*(path[-1] - (70, 20))) < 5
    assert np.hypot(*(path - DISC[0, :2]).T).min() > DISC[0, 2]
    again = pilot.resume(decode(RollerPilot, *encode(session.pilot)))
    for one, two in zip(*map(jax.tree.leaves, (again, session.pilot)), strict=True):
        assert np.array_equal(one, two, equal_nan=True)
    assert math.isfinite(again.reserve.until)


@pytest.mark.slow
def test_a_robot_that_answers_no_more_is_given_up():
    pilot = RollerPilot(np.array([700.0, 20.0]), 3.0, DISC)
    robot = Robot(drift=(0.0, 0.0))
    _, session, _ = fly(pilot, 110, robot)
    begun = session.pilot
    assert begun.stalls == 0
    where = np.array([robot.x, robot.y])
    modes = []
    for _ in range(6):
        begun = begun._watch_progress(where, 1e3 * (len(modes) + 1))
        modes.append(begun.stalls)
    assert modes[-1] > 3
    _, advice = begun.after(session.estimator, HELLO, session.last.t)
    assert advice.intent is Intent.GIVE_UP


def test_before_the_robot_is_seen_nothing_moves():
    pilot = RollerPilot(np.array([70.0, 20.0]), 3.0, DISC)
    session = Session(estimator(), pilot).after(line(HELLO)).session
    outcome = session.after(frame_line(0, x=None))
    (command,) = [a for a in outcome.answers if isinstance(a, Command)]
    assert command.frequency == 0.0
    assert outcome.session.mode is Mode.HOLDING


def test_probes_turn_by_the_golden_angle_and_stay_near():
    pilot = RollerPilot(np.array([70.0, 20.0]), 3.0, DISC[:0])
    headings = []
    for probe in range(12):
        pilot, advice = pilot._look_about(estimator(), HELLO, 1.6 * probe, Intent.PROBE)
        assert isinstance(advice, Advice)
        headings.append(advice.heading)
    turns = np.mod(np.diff(headings), 2 * math.pi)
    assert np.allclose(turns, math.pi * (3 - math.sqrt(5)))
    steps = np.stack([np.cos(headings), np.sin(headings)], axis=1)
    assert np.hypot(*np.cumsum(steps, axis=0).T).max() < 2.1


def test_the_way_leads_along_a_tangent_only_where_a_disc_is_in_it():
    start, goal = np.zeros(2), np.array([70.0, 20.0])
    target = _way_point(start, goal, DISC)
    assert not np.array_equal(target, goal)
    assert math.dist(target, DISC[0, :2]) > DISC[0, 2]
    assert np.array_equal(_way_point(start, np.array([-70.0, 0.0]), DISC), [-70.0, 0.0])
    inside = _tangent(DISC[0, :2] + 1.0, goal, DISC[0, :2], 12.0)
    assert math.dist(inside, DISC[0, :2]) > 12.0
