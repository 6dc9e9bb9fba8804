"""`pinav live` over many kills, many robots and many hours, on the simulated rig.

PINAV_HOURS=12 pytest validation/test_live_long.py -s
"""

import os
import resource
import time
from itertools import islice

import numpy as np
import pytest
from tests.live.processes import kill_and_resume
from tests.live.sessions import frame_line, line, steer
from tests.rig import Robot

from pinav.live.estimators import DriveEstimator
from pinav.live.messages import VERSION, EventKind, Hello, Limits
from pinav.live.roller_pilot import RollerPilot
from pinav.live.session import Session

FIRST = int(os.environ.get("PINAV_FIRST_ROBOT", "300"))
"""Robots below 300 were looked at while the filter was made."""

ROBOTS = int(os.environ.get("PINAV_ROBOTS", "200"))
EVERY = int(os.environ.get("PINAV_ROBOT_STEP", "1"))
"""2 takes every other robot, from the first one on."""

HOURS = float(os.environ.get("PINAV_HOURS", "1"))
KILLS = int(os.environ.get("PINAV_KILLS", "100"))

FRAMES_A_SECOND = 20


def hello(step):
    limits = Limits(frequency=3.0)
    return line(Hello(version=VERSION, session="long", step=step, limits=limits))


def draw_robot(draw, seed, step=0.1):
    """A robot of unknown gain, offset, response, drift, noise and delay."""
    turn, drift = draw.uniform(0, 2 * np.pi), draw.uniform(0, 0.6)
    return Robot(
        gain=draw.uniform(4, 14),
        offset=draw.uniform(-np.pi, np.pi),
        drift=(float(drift * np.cos(turn)), float(drift * np.sin(turn))),
        corner=draw.uniform(1.0, 3.0),
        residual=draw.uniform(0.1, 0.6),
        noise=draw.uniform(0.1, 0.5),
        late=int(draw.integers(0, 6)),
        step=step,
        seed=seed,
    )


def draw_discs(draw, least, most):
    """A gate of two discs across the way, and one disc beside it."""
    gap = draw.uniform(least, most)
    across, along = draw.uniform(-4, 4), draw.uniform(45, 60)
    radius = draw.uniform(8, 14)
    middle = radius + gap / 2
    gate = [[along, across + s * middle, radius] for s in (-1, 1)]
    aside = [draw.uniform(35, 45), draw.choice([-1, 1]) * draw.uniform(50, 55), 10.0]
    return np.array([*gate, aside])


def wide_gate(number):
    draw = np.random.default_rng([18, number])
    return draw_robot(draw, number), draw_discs(draw, 14, 20)


def narrow_gate(number):
    """A gate of 8 to 14 um in a drift of 1 to 6 um/s."""
    draw = np.random.default_rng([18, number])
    robot = draw_robot(draw, number)
    turn, drift = draw.uniform(0, 2 * np.pi), draw.uniform(1, 6)
    robot.drift = float(drift * np.cos(turn)), float(drift * np.sin(turn))
    return robot, draw_discs(draw, 8, 14)


def gusts(number):
    """The same, and every four seconds another drift of up to 8 um/s."""
    robot, discs = narrow_gate(number)
    draw, move = np.random.default_rng([19, number]), robot.move

    def move_blown(frequency, heading):
        if round(robot.t / robot.step) % 40 == 0:
            turn, drift = draw.uniform(0, 2 * np.pi), draw.uniform(0, 8)
            robot.drift = float(drift * np.cos(turn)), float(drift * np.sin(turn))
        move(frequency, heading)

    robot.move = move_blown
    return robot, discs


WORLDS = {
    "wide": (wide_gate, 0.005, 0.95),
    "narrow": (narrow_gate, 0.005, 0.85),
    "gusts": (gusts, 0.25, 0.1),
}
"""Robots and discs, how many may enter one, and how many must arrive."""


@pytest.mark.parametrize("world", WORLDS)
def test_no_robot_enters_a_disc_on_its_way_through_a_gate(world):
    """Robots, gates and discs drawn anew; 60 s each, of 600 frames."""
    make, most_enter, least_arrive = WORLDS[world]
    entered, times, depth = [], [], []
    for number in range(FIRST, FIRST + EVERY * ROBOTS, EVERY):
        robot, discs = make(number)
        session = Session(
            DriveEstimator(), RollerPilot(np.array([100.0, 0.0]), 4.0, discs)
        )
        session = session.after(hello(0.1)).session
        path, there = [], False
        for place, _, events in islice(steer(session, robot), 600):
            path.append(place)
            there = any(event.kind is EventKind.ARRIVED for event in events)
            if there:
                break
        away = np.hypot(*(np.array(path)[:, None] - discs[:, :2]).T).T - discs[:, 2]
        entered.append(bool(away.min() < 0))
        depth.append(float(-away.min()))
        times.append(0.1 * len(path) if there else np.inf)
        if entered[-1]:
            print(f"robot {number} entered a disc by {depth[-1]:.2f}: {robot}")
    # With no entry in n runs the one-sided bound of 95 % is 3 / n.
    arrived = np.isfinite(times)
    print(
        f"{world}: {sum(entered)} of {ROBOTS} entered a disc, {arrived.sum()} arrived "
        f"after {np.median(times):.1f} s (median); least clearance {-max(depth):.2f} um"
    )
    assert sum(entered) <= most_enter * ROBOTS
    assert arrived.sum() >= least_arrive * ROBOTS


def test_hours_leave_memory_and_latency_as_they_were():
    """A robot that is driven about at 20 frames a second."""
    draw, step = np.random.default_rng(18), 1 / FRAMES_A_SECOND
    robot = draw_robot(draw, 0, step)
    session = Session(DriveEstimator()).after(hello(step)).session
    begin, count = time.perf_counter(), int(3600 * HOURS * FRAMES_A_SECOND)
    each, sizes, latencies = max(count // 12, 1), [], []
    command, took = (0.0, 0.0), []
    for seq in range(count):
        if seq % (3 * FRAMES_A_SECOND) == 0:
            command = float(draw.uniform(0.3, 3.0)), float(draw.uniform(-np.pi, np.pi))
        x, y = robot.seen()
        more = {"frequency": command[0], "heading": command[1]}
        text = frame_line(seq, t=robot.t, x=x, y=y, **more)
        asked = time.perf_counter()
        session = session.after(text).session
        took.append(time.perf_counter() - asked)
        robot.move(*command)
        if len(took) == each:
            sizes.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
            latencies.append(np.quantile(took, [0.5, 0.99]) * 1e3)
            took = []
            print(f"{robot.t / 3600:.2f} h: {sizes[-1]:.0f} MB, {latencies[-1]} ms")
    print(f"{HOURS:g} h took {(time.perf_counter() - begin) / 3600:.2f} h")
    assert session.counts.frames == count
    assert time.perf_counter() - begin < 3600 * HOURS
    assert sizes[-1] < sizes[0] + 5
    assert latencies[-1][0] < 1.5 * latencies[0][0]


def test_a_session_that_is_killed_again_and_again_learns_each_frame_once(tmp_path):
    resumed = kill_and_resume(tmp_path, KILLS, 2.5)
    print(f"{KILLS} kills; resumed at {len(set(resumed))} different frames")
    assert len(set(resumed)) > KILLS / 3
