"""The last filter of a live session, on a robot whose drive is known."""

import dataclasses
import math

import numpy as np
import pytest
from tests.identification.running.test_running_fit import run, small_grid
from tests.rig import Robot

from pinav.identification.running import RunningFit
from pinav.live.safety import Outlook, Reserve, distances

DRIFT = 4.0

FULL = 3.0


@pytest.fixture(scope="module")
def known():
    """A robot in a strong drift along x, after a while of drive."""
    robot = Robot(drift=(DRIFT, 0.0), noise=0.1)
    fit, robot = run(RunningFit.begin(small_grid()), 200, robot)
    return fit.after(robot.t, robot.seen(), 0.0, 0.0), robot


def outlook(known, *discs):
    """Among discs whose places are relative to the robot's."""
    fit, robot = known
    here = np.array([robot.x, robot.y])
    discs = np.array(discs).reshape(-1, 3) + np.array([*here, 0.0])
    return Outlook(fit, robot.t, 0.1, here, 0.1, FULL, discs)


def towards(angle):
    """Full drive along an angle; the motion is turned against the heading by 1.4."""
    return np.array([FULL, math.remainder(angle - 1.4, 2 * math.pi)])


def margin(view, order):
    """Least distance of the tube of a command that is held."""
    return view.clearances(order, order, 2.0).min()


def test_far_from_discs_every_command_goes_through(known):
    view = outlook(known, (500.0, 0.0, 10.0))
    for angle in np.arange(0.0, 6.0, 0.7):
        verdict = view.judge(towards(angle), Reserve())
        assert not verdict.changed
        assert np.array_equal(verdict.order, towards(angle))
        assert verdict.reserve.until > view.time + 2.0


def test_a_command_into_a_disc_becomes_one_that_is_clear(known):
    view = outlook(known, (0.0, 30.0, 12.0))
    wanted = towards(math.pi / 2)
    assert margin(view, wanted) < 0
    verdict = view.judge(wanted, Reserve())
    assert verdict.changed
    assert margin(view, verdict.order) >= 0


@pytest.mark.parametrize("side", [0.5, 1.0, 1.5])
def test_ways_out_lead_in_every_direction(known, monkeypatch, side):
    wanted = towards(0.0)
    away = wanted[1] + side * math.pi

    def clear_ahead(self, firsts, escapes, ahead):
        headings = np.broadcast_arrays(firsts, escapes)[1][..., 1]
        return np.cos(headings - away)[..., None] - 0.9

    monkeypatch.setattr(Outlook, "clearances", clear_ahead)
    verdict = outlook(known, (500.0, 0.0, 10.0)).judge(wanted, Reserve())
    assert verdict.changed
    assert math.cos(verdict.order[1] - away) > 0.9
    assert math.cos(verdict.reserve.order[1] - away) > 0.9


def test_to_stand_still_is_no_refuge_in_a_drift(known):
    view = outlook(known, (4.0 + DRIFT, 0.0, 5.0))
    still = np.array([0.0, 0.0])
    assert margin(view, still) < 0
    verdict = view.judge(still, Reserve())
    assert verdict.changed
    assert verdict.order[0] > 0
    assert math.cos(verdict.order[1] + 1.4) < 0.5


def test_the_reserve_is_a_way_out_after_the_command(known):
    view = outlook(known, (25.0, 0.0, 12.0))
    verdict = view.judge(towards(0.0), Reserve())
    kept = view.clearances(verdict.order, verdict.reserve.order, 2.0).min()
    assert kept >= margin(view, verdict.order)
    assert kept >= 0


def narrow(known):
    """Discs all around, in which no command is clear for long, but rest for a while."""
    angles = np.arange(8) * math.pi / 4
    ring = [(11.0 * math.cos(a), 11.0 * math.sin(a), 5.0) for a in angles]
    view = outlook(known, *ring)
    still = np.zeros(2)
    assert margin(view, still) < 0
    assert view.clearances(still, still, 0.2).min() > 0
    return view


def test_where_no_command_is_clear_a_reserve_is_followed_while_it_is(known):
    view = narrow(known)
    reserve = Reserve(np.array([0.0, 0.7]), view.time + 0.3)
    verdict = view.judge(towards(0.0), reserve)
    assert verdict.changed
    assert np.array_equal(verdict.order, reserve.order)
    assert verdict.reserve.until == reserve.until
    order = np.array([0.0, 0.7])
    none = view.judge(towards(0.0), Reserve())
    for given_up in (
        Reserve(order, view.time + 0.05),
        Reserve(towards(0.0), view.time + 2.0),
    ):
        verdict = view.judge(towards(0.0), given_up)
        assert np.array_equal(verdict.order, none.order)
        assert not np.array_equal(verdict.order, given_up.order)


def test_a_disc_between_two_moments_of_a_path_is_met():
    path = np.array([[0.0, 0.0], [100.0, 1.0], [100.0, 1.0]])
    discs = np.array([[50.0, 0.0, 2.0], [500.0, 0.0, 30.0]])
    apart = distances(path, discs)
    across, along = 50.0 / math.hypot(100.0, 1.0), math.hypot(50.0, 1.0)
    np.testing.assert_allclose(apart, [across - 2.0, along - 2.0])


def test_a_wider_state_makes_a_wider_tube(known):
    view = outlook(known, (60.0, 0.0, 5.0))
    wide = dataclasses.replace(view, sd=3.0)
    still = np.zeros(2)
    assert margin(wide, still) < margin(view, still) - 5.0


def test_whoever_is_too_near_already_is_driven_away(known):
    """Every plan begins within the tube, so that none is clear, nor any reserve."""
    view = dataclasses.replace(outlook(known, (5.2, 0.0, 5.0)), sd=0.5)
    assert margin(view, towards(math.pi)) < 0
    for wanted in (towards(0.0), np.zeros(2)):
        verdict = view.judge(wanted, Reserve(np.zeros(2), view.time + 1.0))
        assert verdict.changed
        assert verdict.order[0] > 0
        assert math.cos(verdict.order[1] + 1.4) < -0.5
