"""Both processes: a simulated rig with faults, and `pinav live`, by file and socket."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from tests.live.processes import Both, kill_and_resume

pytestmark = pytest.mark.slow

STEER = ("--to=60,40", "--tolerance", "4", "--keep-out=45,10,12")


@pytest.mark.parametrize(
    ("way", "faults"),
    [
        ("file", ("garbage", "half", "repeat", "back", "lost", "swap", "truncate")),
        ("file", ("rotate", "forward", "burst")),
        ("socket", ("garbage", "repeat", "forward", "lost", "swap", "burst", "close")),
    ],
)
def test_the_goal_is_reached_through_faults_and_the_disc_is_not_entered(
    tmp_path, way, faults
):
    both = Both(tmp_path, way, *faults)
    complaint = both.wait(both.start(*STEER))
    assert "Traceback" not in complaint
    truth = both.told()
    kinds = {event["kind"] for event in both.said("event")}
    assert "arrived" in kinds, kinds
    assert np.hypot(*(truth[:, 2:4] - (45, 10)).T).min() > 12
    assert np.hypot(*(truth[:, 2:4] - (60, 40)).T).min() < 5
    expected = {"garbage": "refused", "repeat": "repeated", "lost": "lost"}
    expected |= {"back": "jump", "forward": "jump", "swap": "reacquired"}
    expected |= {"rotate": "source", "truncate": "source", "close": "source"}
    assert {expected[fault] for fault in faults if fault in expected} <= kinds
    known = [state for state in both.said("state") if state["gain"] is not None]
    assert abs(known[-1]["offset"] - 1.4) < 0.15
    assert abs(known[-1]["gain"] - 9 * (0.3 + 0.7 * 2 / 5**0.5)) < 1.0


def test_a_killed_session_goes_on_as_if_nothing_had_been(tmp_path):
    """Killed at random frames; the belief is that of a session that lived on."""
    kill_and_resume(tmp_path, 3, 2.5)


def test_a_rig_without_pinav_stops(tmp_path):
    both = Both(tmp_path, "file", frames=300, pace="0.02")
    process = both.start(*STEER)
    ends = time.monotonic() + 60
    while not (tmp_path / "commands.jsonl").exists() and time.monotonic() < ends:
        time.sleep(0.05)
    time.sleep(1.5)
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    both.rig.wait(60)
    both.rig.stdout.close()
    truth = both.told()
    assert truth[:, 4].any()
    assert not truth[-20:, 4].any()


def test_a_file_and_a_replay_of_it_say_the_same(tmp_path):
    both = Both(tmp_path, "file", frames=150, pace="0.01")
    both.wait(both.start("--watch"))
    words = [sys.executable, "-m", "pinav", "live", str(both.frames), "--replay"]
    one, two = (subprocess.run(words, capture_output=True, check=True) for _ in "ab")
    assert one.stdout == two.stdout
    replayed = [json.loads(line) for line in one.stdout.splitlines()]
    states = [row | {"latency_ms": None} for row in replayed if row["type"] == "state"]
    live = [row | {"latency_ms": None} for row in both.said("state")]
    assert live == states
