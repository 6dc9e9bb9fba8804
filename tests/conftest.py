"""Strict JAX, strict types: set before any test imports pinav."""

import gc
import importlib.util
import itertools
import os
import shutil
import tempfile
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does
# Most of the time goes into compiling: a third less without LLVM's optimisations, and a
# sixth less of that where a program is not divided among threads.
os.environ.setdefault(
    "XLA_FLAGS",
    "--xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1",
)
os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "true")  # but: `optimised`
os.environ.setdefault("JAX_TRACEBACK_FILTERING", "off")  # which takes time
os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"

import hypothesis
import jax
import jaxtyping
import pytest
from tests.fitted_runs import FittedRuns
from tests.stored_numbers import StoredNumbers

jax.config.update("jax_enable_x64", val=True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")

if "PINAV_UNCHECKED" not in os.environ:  # `make test-slow`: as users run the package
    jaxtyping.install_import_hook("pinav", "beartype.beartype")
hypothesis.settings.register_profile("no deadline", deadline=None)
hypothesis.settings.load_profile("no deadline")  # other work may slow the machine


gc.set_threshold(50_000, 20, 100)  # as the command line does


@pytest.fixture
def optimised(monkeypatch):
    """Compile with optimisations, also in processes, for closed loops of many steps."""
    before = jax.config.read("jax_disable_most_optimizations")
    monkeypatch.setenv("JAX_DISABLE_MOST_OPTIMIZATIONS", "false")
    jax.config.update("jax_disable_most_optimizations", val=False)
    yield
    jax.config.update("jax_disable_most_optimizations", val=before)


MOST_KEPT = 2**30
"""Bytes of compiled code that are kept for the next call."""


@pytest.fixture(scope="module", autouse=True)
def _let_compiled_programs_go():
    """Each compiled program holds several of the regions that Linux allows."""
    yield
    from pinav.numerics import free_programs  # after the hook that checks types

    free_programs()


STATES = {}
"""State of the generator of each module when its first test began."""


@pytest.fixture(autouse=True)
def _draw_the_same_in_any_order(request):
    """Each test begins with the generator `RNG` of its module as it was imported.

    Otherwise its numbers would depend on the tests that ran before it in its worker.
    """
    generator = getattr(request.module, "RNG", None)
    if generator is not None:
        state = STATES.setdefault(request.module, generator.bit_generator.state)
        generator.bit_generator.state = state


def pytest_configure(config):
    """One folder of fitted runs and one of compiled code for all workers.

    Runs are made for each call, except below a folder that `PINAV_TESTS` names, where
    later calls find them (`.ci/run`). Compiled code is kept: its keys hold the program,
    the flags and the version of the compiler. Processes that tests start, and may kill
    while they write, have a folder of their own.
    """
    if "PINAV_TESTS" not in os.environ:
        made = tempfile.mkdtemp(prefix="pinav-tests-")
        os.environ["PINAV_TESTS"] = made
        config.add_cleanup(lambda: shutil.rmtree(made, ignore_errors=True))
    of_processes = os.path.join(os.environ["PINAV_TESTS"], "compiled")
    os.environ["JAX_COMPILATION_CACHE_DIR"] = of_processes
    kept = config.rootpath / ".pytest_cache" / "compiled"
    if not hasattr(config, "workerinput"):
        _empty_when_large(kept)
    jax.config.update("jax_compilation_cache_dir", str(kept))


def _empty_when_large(folder: Path) -> None:
    if sum(path.stat().st_size for path in folder.glob("*")) > MOST_KEPT:
        shutil.rmtree(folder, ignore_errors=True)


def pytest_collection_modifyitems(items):
    """Begin with the pages: the longest tests must not be left for one worker."""
    items.sort(key=lambda item: item.path.name != "test_docs.py")


def pytest_collection_finish():
    """Leave what was imported out of every later search for garbage."""
    gc.freeze()


def pytest_addoption(parser):
    parser.addoption(
        "--extras", action="store_true", help="fail where a package is missing"
    )
    parser.addoption("--renew", action="store_true", help="write tests/numbers anew")


def pytest_runtest_setup(item):
    """Skip a test whose extra packages are missing; with --extras it fails."""
    for marker in item.iter_markers("extras"):
        missing = [
            name for name in marker.args if importlib.util.find_spec(name) is None
        ]
        if missing and item.config.getoption("--extras"):
            pytest.fail(f"{', '.join(missing)} missing: make test-extras installs them")
        if missing:
            pytest.skip(f"{', '.join(missing)} not installed (make test-extras)")


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
def fitted_runs():
    """Runs that were fitted once for all tests and workers (tests/fitted_runs.py)."""
    return FittedRuns(Path(os.environ["PINAV_TESTS"]) / "runs")


@pytest.fixture
def fitted_run(fitted_runs, tmp_path_factory):
    """A copy of one of `RUNS`, which the test may change, and the path of its data.

    A module whose tests only read one run makes a fixture of its own:

        @pytest.fixture(scope="module")
        def run(fitted_runs, tmp_path_factory):
            return fitted_runs.copy("kernel", tmp_path_factory.mktemp("run"))[0]
    """
    return lambda name: fitted_runs.copy(name, tmp_path_factory.mktemp(name))


@pytest.fixture(scope="session")
def tiny_fit(fitted_runs, tmp_path_factory):
    """The run `network` and its data, to be read alone."""
    return fitted_runs.copy("network", tmp_path_factory.mktemp("fit"))


@pytest.fixture(scope="session")
def same_numbers(request):
    """The comparison of results with tests/numbers (tests/stored_numbers.py)."""
    return StoredNumbers(renew=request.config.getoption("--renew"))


@pytest.fixture
def printed(capsys):
    """What a command prints that ends with success."""

    def run(*words):
        from pinav import cli

        capsys.readouterr()
        with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
            assert cli.run([*map(str, words)]) == 0
        return capsys.readouterr().out

    return run


@pytest.fixture
def refused(capsys):
    """Check that a command is refused with one line that holds some words.

    It writes no folder that was not there before.
    """

    def check(argv, words):
        from pinav import cli

        argv = [*map(str, argv)]
        outs = [Path(out) for word, out in itertools.pairwise(argv) if word == "--out"]
        before = [out.exists() for out in outs]
        capsys.readouterr()
        with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
            assert cli.run(argv) == cli.USAGE_ERROR
        *_, line = capsys.readouterr().err.splitlines()
        assert line.startswith("pinav: ")
        assert words in line
        assert [out.exists() for out in outs] == before

    return check
