"""`kill -9` at random moments, then `--resume`: the same numbers as an unbroken run."""

import os
import random
import signal
import subprocess
import sys
import time

import pytest
from validation.conftest import pinav

RESULTS = ("metrics.json", "table2.csv", "model-ude-42.eqx", "model-nn-only-42.eqx")
STEPS = ["--recipe", "paper", "--adam-steps", "1500", "--lbfgs-steps", "100"]


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory):
    out = tmp_path_factory.mktemp("kill") / "unbroken"
    start = time.monotonic()
    assert pinav("reproduce", *STEPS, "--out", str(out)).returncode == 0
    return out, time.monotonic() - start


@pytest.mark.parametrize("draw", range(3))
def test_a_killed_run_resumes_to_the_same_numbers(unbroken, draw, tmp_path):
    whole, seconds = unbroken
    moment = random.SystemRandom().uniform(0.05, 0.95) * seconds
    command = [sys.executable, "-c", "from pinav.cli import main; main()"]
    words = ["reproduce", *STEPS, "--out", str(tmp_path / "run")]
    process = subprocess.Popen(
        command + words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    time.sleep(moment)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    there = sorted(p.name for p in (tmp_path / "run").glob("*"))
    print(f"killed after {moment:.1f} of {seconds:.1f} s; there: {', '.join(there)}")
    done = pinav(*words, "--resume")
    assert done.returncode == 0, done.stderr
    for name in RESULTS:
        resumed = (tmp_path / "run" / name).read_bytes()
        assert resumed == (whole / name).read_bytes(), f"{name} differs"
