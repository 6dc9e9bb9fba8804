"""Both processes: a simulated rig with faults, and `pinav live`, by file and socket."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from pinav.live.checkpoint import read_session
from pinav.live.drive_estimator import DriveEstimator
from pinav.live.session import Session

pytestmark = pytest.mark.slow

RIG = Path(__file__).parents[1] / "rig.py"
STEER = ("--to=60,40", "--tolerance", "4", "--keep-out=45,10,12")


class Both:
    """A rig and a pinav, by a growing file or by a socket."""

    def __init__(
        self, folder: Path, way: str, *faults: str, frames: int = 420, pace="0.002"
    ):
        self.folder, self.way = folder, way
        self.frames, self.truth = folder / "frames.jsonl", folder / "truth.jsonl"
        words = ["--truth", str(self.truth), "--frames", str(frames), "--pace", pace]
        words += ["--wait"] if pace == "0.002" else []
        words += [word for fault in faults for word in ("--fault", fault)]
        if way == "file":
            commands = folder / "commands.jsonl"
            words += ["--file", str(self.frames), "--commands", str(commands)]
            self.words = [str(self.frames), "--commands-to", str(commands)]
        self.rig = subprocess.Popen(
            [sys.executable, RIG, *words], stdout=subprocess.PIPE, text=True
        )
        if way == "socket":
            port = self.rig.stdout.readline().strip()
            self.words = [f"tcp://127.0.0.1:{port}"]

    def start(self, *words: str, out: str = "out.jsonl") -> subprocess.Popen:
        with (self.folder / out).open("w") as file:
            return subprocess.Popen(
                [sys.executable, "-m", "pinav", "live", *self.words, *words],
                stdout=file,
                stderr=subprocess.PIPE,
                text=True,
            )

    def wait(self, process: subprocess.Popen) -> str:
        """Let the rig end, and then pinav; what it complained of."""
        self.rig.wait(120)
        self.rig.stdout.close()
        _, complaint = process.communicate(timeout=60)
        return complaint

    def said(self, kind: str, out: str = "out.jsonl") -> list[dict]:
        lines = (self.folder / out).read_text().splitlines()
        return [row for line in lines if (row := json.loads(line))["type"] == kind]

    def told(self) -> np.ndarray:
        """Number, time, position and command of each frame, as they truly were."""
        return np.array(
            [json.loads(line) for line in self.truth.read_text().splitlines()]
        )


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
    both = Both(tmp_path, "file", frames=600, pace="0.02")
    keep = ("--out", str(tmp_path / "kept"), "--watch")
    draw = np.random.default_rng(0)
    begin = time.monotonic()
    for number in range(3):
        process = both.start(*keep, *(["--resume"] * (number > 0)), out=f"{number}")
        while not (tmp_path / "kept" / "session.npz").exists():
            time.sleep(0.05)
            assert time.monotonic() < begin + 60
        time.sleep(draw.uniform(1.0, 2.5))
        process.kill()
        process.communicate()
    both.rig.wait(60)
    complaint = both.wait(both.start(*keep, "--resume", out="last"))
    assert "Traceback" not in complaint
    last = both.said("state", "last")
    seqs = [state["seq"] for state in last]
    assert seqs == list(range(seqs[0], 600))
    ready = both.said("ready", "last")[0]
    assert ready["resumed_at"] == seqs[0] - 1 > 0
    kept = read_session(tmp_path / "kept" / "session.npz", Session(DriveEstimator()))
    assert kept.counts.frames == 600
    whole = Session(DriveEstimator())
    for line in both.frames.read_bytes().splitlines():
        whole = whole.after(line).session
    for name, array in whole.estimator.to_arrays().items():
        again = kept.estimator.to_arrays()[name]
        assert np.allclose(array, again, rtol=0, atol=1e-9, equal_nan=True), name


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
