"""Both processes, the simulated rig and `pinav live`, as tests start and kill them."""

import json
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np

from pinav.live.checkpoint import read_session
from pinav.live.estimators import DriveEstimator
from pinav.live.session import Session

RIG = Path(__file__).parents[1] / "rig.py"


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


def kill_and_resume(folder: Path, kills: int, most: float) -> list[int]:
    """Kill a session at random moments while it learns, and resume it each time.

    Each session lives on for up to `most` seconds after its first frame. The belief at
    the end is that of a session that was never killed, and no frame is learned twice.

    Args:
        folder: of all files.
        kills: how many sessions end by `kill -9`.
        most: longest life of a session after it began to learn [s].

    Returns:
        The frames that were learned from when each session began anew.
    """
    frames = int(kills * (most + START) / PACE)
    both = Both(folder, "file", frames=frames, pace=str(PACE))
    keep = ("--out", str(folder / "kept"), "--watch")
    draw, resumed = np.random.default_rng(0), []
    for number in range(kills):
        begin = time.monotonic()
        process = both.start(*keep, *(["--resume"] * (number > 0)), out=f"{number}")
        while b'"state"' not in (folder / f"{number}").read_bytes():
            time.sleep(0.02)
            assert time.monotonic() < begin + 60
        time.sleep(draw.uniform(0, most))
        process.kill()
        process.communicate()
        lines = (folder / f"{number}").read_bytes().splitlines()
        # A killed process may leave half a line.
        words = [json.loads(line) for line in lines if line.endswith(b"}")]
        resumed += [w["resumed_at"] for w in words if w["type"] == "ready"]
    both.rig.wait(max(60, frames * PACE))
    complaint = both.wait(both.start(*keep, "--resume", out="last"))
    assert "Traceback" not in complaint
    (ready,) = both.said("ready", "last")
    assert ready["resumed_at"] > 0
    seqs = [state["seq"] for state in both.said("state", "last")]
    assert seqs == list(range(ready["resumed_at"] + 1, frames))
    kept = read_session(folder / "kept" / "session.npz", Session(DriveEstimator()))
    assert kept.counts.frames == frames
    whole = Session(DriveEstimator())
    for line in both.frames.read_bytes().splitlines():
        whole = whole.after(line).session
    leaves = map(jax.tree.leaves, (whole.estimator, kept.estimator))
    for array, again in zip(*leaves, strict=True):
        assert np.allclose(array, again, rtol=0, atol=1e-9, equal_nan=True)
    resumed = [seq for seq in resumed if seq is not None]
    assert sorted(resumed) == resumed
    return resumed


PACE, START = 0.02, 2.5
"""Time between frames [s]; that of a process to start, for the length of the rig."""
