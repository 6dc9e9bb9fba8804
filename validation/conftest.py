"""Slow reproductions of published numbers; run with `make validate`."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import pytest

from pinav.commands.reproduce.sections import Reproduction
from pinav.runs import RunFolder

COLD = {"JAX_ENABLE_COMPILATION_CACHE": "false"}


@pytest.fixture(autouse=True, scope="session")
def double_precision():
    """As the command line has it."""
    jax.config.update("jax_enable_x64", val=True)


def pinav(*words: str, **options) -> subprocess.CompletedProcess:
    """Run the command line in a process of its own, with nothing compiled yet."""
    return program("pinav", *words, **options)


def program(module: str, *words: str, **options) -> subprocess.CompletedProcess:
    """Run a module as a program, in a process of its own."""
    command = [sys.executable, "-m", module, *words]
    environ = os.environ | COLD
    return subprocess.run(
        command, text=True, capture_output=True, env=environ, **options
    )


@pytest.fixture(scope="session")
def paper_run(tmp_path_factory):
    """The paper's recipe over seeds 0 to 4 and 42, and its result."""
    out: Path = tmp_path_factory.mktemp("paper") / "run"
    seeds = ["42", "0", "1", "2", "3", "4"]
    done = pinav("reproduce", "--recipe", "paper", "--seeds", *seeds, "--out", str(out))
    assert done.returncode == 0, done.stderr
    print(done.stdout)
    return RunFolder.open(out).load("metrics", Reproduction)
