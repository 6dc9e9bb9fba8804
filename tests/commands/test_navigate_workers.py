"""`pinav navigate --workers`: the same loops as cells, and what is done stays done."""

import json
import shutil

import jax
import msgspec
import numpy as np
import pytest
from tests.sweeps.here import here

from pinav.commands import NAVIGATE, sweep
from pinav.commands.navigate import NavigateOptions, NavigateSettings, job
from pinav.commands.navigate.job import navigation_problem, sweep_loops
from pinav.commands.settings import WorkerSettings
from pinav.commands.sweep import start_sweep
from pinav.learning.learned import Learned
from pinav.navigation import Episodes
from pinav.navigation.comparison import try_model
from pinav.navigation.problem import PHYSICS
from pinav.sweeps import CellStore


@pytest.fixture
def workers_here(monkeypatch):
    """Workers are this process, which has the programs compiled."""
    monkeypatch.setattr(sweep, "local_cluster", lambda count: here())


def test_runs_are_selected_with_all_that_is_theirs():
    count = 4
    episodes = Episodes(
        ts=np.arange(3.0),
        states=np.arange(24.0).reshape(count, 3, 2),
        commands=np.arange(16.0).reshape(count, 2, 2),
        steps=np.arange(count),
        reached=np.array([True, False, True, False]),
        violated=np.zeros(count, bool),
        arrival_time=np.arange(4.0),
        clearance=np.arange(4.0),
        compute=np.zeros(0),
    )
    two = episodes.select(np.array([2, 1]))
    np.testing.assert_array_equal(two.steps, [2, 1])
    np.testing.assert_array_equal(two.reached, [True, False])
    np.testing.assert_array_equal(two.states, episodes.states[[2, 1]])
    np.testing.assert_array_equal(two.ts, episodes.ts)


@pytest.mark.slow
def test_loops_of_cells_are_those_of_the_command(
    fitted_run, tmp_path, workers_here, monkeypatch
):
    monkeypatch.setattr(job, "LOOPS_OF_A_CELL", 1)
    run, out = fitted_run("kernel")[0], tmp_path / "out"
    settings = NavigateSettings(start="1,8.5", goal="8.5,8.5", samples=0, seeds=2)
    options = NavigateOptions(
        run=run, settings=settings, out=out, workers=WorkerSettings(workers=2)
    )

    def swept(resume):
        again = msgspec.structs.replace(options, resume=resume)
        with start_sweep(NAVIGATE, again, again.workers, settings) as of:
            return dict(sweep_loops(of, settings, run, [PHYSICS]))[PHYSICS]

    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        problem = navigation_problem(settings, Learned.open(run))
        _, here = try_model(problem, PHYSICS, settings.seeds, settings.seed)
        first = swept(resume=False)
        stays, goes = sorted(CellStore.of_run(out).path.glob("*/outcome.json"))
        before = stays.stat().st_mtime_ns
        shutil.rmtree(goes.parent)
        second = swept(resume=True)
    assert stays.stat().st_mtime_ns == before
    for loops in (first, second):
        np.testing.assert_array_equal(loops.states, here.states)
        np.testing.assert_array_equal(loops.arrival_time, here.arrival_time)
    assert here.reached.all()


@pytest.mark.slow
def test_a_killed_flight_is_flown_again_and_no_other(tmp_path, workers_here, printed):
    out = tmp_path / "out"
    words = ["navigate", "--learn-online", "vortex", "--seeds", "2", "--visits", "1"]
    words += ["--json", "--out", out]
    first = json.loads(printed(*words))["controllers"]
    (out / "metrics.json").unlink()
    store = CellStore.of_run(out)
    stays, goes = sorted(store.path.glob("*/outcome.json"))
    before = stays.stat().st_mtime_ns
    shutil.rmtree(goes.parent)
    second = json.loads(printed(*words, "--resume"))["controllers"]
    for name in first:
        for part in ("arrival", "success", "force_error", "cover", "consistency"):
            assert first[name][part] == second[name][part]
    assert stays.stat().st_mtime_ns == before
    assert goes.exists()
