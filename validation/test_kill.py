"""`kill -9` at random moments: the same numbers as an unbroken run."""

import os
import random
import signal
import subprocess
import sys
import time

import psutil
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


FITS = [
    "study",
    "noise",
    "--models",
    "kernel-potential",
    "physics-only",
    "--count",
    "2",
]
FITS += ["--held-out", "4", "--sigmas", "0.005", "0.01", "0.02", "0.05", "0.1"]
FITS += ["--seeds", "0", "1", "2", "3"]
KILLS = 100


def test_a_study_of_forty_fits_with_a_hundred_kills_ends_in_the_same_table(tmp_path):
    """Of its two workers, which are replaced, and of itself, which goes on."""
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    assert pinav(*FITS, "--out", str(whole)).returncode == 0
    dice, kills, words = random.Random(0), 0, []
    command = [sys.executable, "-m", "pinav", *FITS, "--out", str(broken)]
    while True:
        process = subprocess.Popen(
            [*command, "--workers", "2", *words],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        words = ["--resume"]
        while process.poll() is None:
            time.sleep(dice.uniform(0.5, 8.0))
            if kills < KILLS and (victims := processes_of(process.pid)):
                kills += 1
                dice.choice(victims).kill()
        assert process.returncode in (0, -signal.SIGKILL)
        if process.returncode == 0:
            break
    print(f"{kills} kills of workers and clients")
    assert kills > 10
    for name in ("study.csv", "metrics.json"):
        assert (broken / name).read_bytes() == (whole / name).read_bytes()


def processes_of(client):
    """The client of a study, rarely, and its workers."""
    try:
        one = psutil.Process(client)
        return [one, *one.children(recursive=True) * 5]
    except psutil.NoSuchProcess:
        return []
