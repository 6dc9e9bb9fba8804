"""Strict JAX, strict types: set before any test imports pinav."""

import os
import shutil
import tempfile
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false")  # this too
os.environ["JAX_COMPILATION_CACHE_MAX_SIZE"] = str(2**31)  # which locks it, too
os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.1"

import hypothesis
import jax
import jaxtyping
import pytest

jax.config.update("jax_enable_x64", val=True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

jaxtyping.install_import_hook("pinav", "beartype.beartype")
hypothesis.settings.register_profile("no deadline", deadline=None)
hypothesis.settings.load_profile("no deadline")  # other work may slow the machine


def pytest_configure(config):
    """One cache of compiled code for this run of the tests, subprocesses included."""
    if not hasattr(config, "workerinput"):
        folder = tempfile.mkdtemp(prefix="pinav-tests-")
        os.environ["JAX_COMPILATION_CACHE_DIR"] = folder
        jax.config.update("jax_compilation_cache_dir", folder)


def pytest_unconfigure(config):
    if not hasattr(config, "workerinput"):
        shutil.rmtree(os.environ["JAX_COMPILATION_CACHE_DIR"], ignore_errors=True)


RECORDINGS = Path(
    os.environ.get("PINAV_RECORDINGS") or Path(__file__).parents[2] / "shared" / "data"
)


@pytest.fixture(scope="session")
def recording():
    """The path of a real recording; the test is skipped where it is absent."""

    def path(name):
        if not (RECORDINGS / name).exists():
            pytest.skip(
                f"no {name} in {RECORDINGS}; set PINAV_RECORDINGS to its folder"
            )
        return RECORDINGS / name

    return path


@pytest.fixture(scope="session")
def paper_trajectories():
    """The paper's benchmark, solved once for all tests."""
    from pinav.scenarios import paper
    from pinav.trajectories import simulate

    return simulate(paper())


@pytest.fixture(scope="session")
def tiny_fit(tmp_path_factory):
    """A run of `pinav fit` with a few steps, and the file that it was fitted to."""
    from pinav import cli

    folder = tmp_path_factory.mktemp("fit")
    data, run = folder / "data.csv", folder / "run"
    assert cli.run(["simulate", "paper", "--out", str(data), "--noise", "0.01"]) == 0
    steps = ["--recipe", "paper", "--adam-steps", "10", "--lbfgs-steps", "2"]
    argv = ["fit", str(data), "--out", str(run), "--model", "ude", *steps]
    argv += ["--learn", "damping"]
    with jax.numpy_dtype_promotion("standard"):
        assert cli.run(argv) == 0
    return run, data
