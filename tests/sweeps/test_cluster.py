"""Sweeps on Dask: a scheduler and workers as processes of this machine."""

import importlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tests.sweeps.test_sweep import cells_of, sweep

from pinav.errors import InputError
from pinav.sweeps import CellStore, DaskCluster, TlsFiles
from pinav.sweeps import cluster as cluster_module

extras = pytest.mark.extras("distributed")
slow = pytest.mark.slow


class Cluster:
    """A scheduler with workers, one thread each, which nannies replace."""

    def __init__(self, folder, *options):
        root = Path(__file__).parents[2]
        self.environment = os.environ | {
            "PYTHONPATH": os.pathsep.join([str(root), *filter(None, sys.path)]),
            "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "2",
        }
        self.folder, self.options = folder, options
        file = folder / "scheduler.json"
        self.scheduler = self.start(
            *("scheduler", "--port", "0", "--host", "127.0.0.1"),
            *("--scheduler-file", str(file), "--no-dashboard"),
        )
        until = time.monotonic() + 30
        while not file.exists() and time.monotonic() < until:
            time.sleep(0.1)
        self.workers = [self.start_worker() for _ in range(2)]
        self.address = self.read_address(file)

    def read_address(self, file):
        return importlib.import_module("json").loads(file.read_text())["address"]

    def start(self, *words):
        command = [sys.executable, "-m", "dask", *words, *self.options]
        with open(self.folder / f"{words[0]}.log", "a") as log:
            return subprocess.Popen(
                command, env=self.environment, stdout=log, stderr=log
            )

    def start_worker(self):
        file = str(self.folder / "scheduler.json")
        return self.start(
            *("worker", "--scheduler-file", file, "--nthreads", "1", "--nworkers"),
            *("1", "--no-dashboard", "--host", "127.0.0.1"),
            *("--local-directory", str(self.folder)),
        )

    def stop(self):
        for process in (*self.workers, self.scheduler):
            process.send_signal(signal.SIGINT)
        for process in (*self.workers, self.scheduler):
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


@pytest.fixture(scope="module")
def dask(tmp_path_factory):
    cluster = Cluster(tmp_path_factory.mktemp("dask"))
    yield cluster
    cluster.stop()


@extras
@slow
@pytest.mark.filterwarnings("ignore")
def test_a_cluster_leaves_the_table_of_this_process(dask, tmp_path):
    cells = cells_of("square", 6)
    outcomes, table = sweep(tmp_path / "dask", cells, DaskCluster(dask.address))
    assert {outcome.failure for outcome in outcomes} == {""}
    assert table == sweep(tmp_path / "here", cells)[1]


@extras
@slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("task", "timeout"), [("leave", None), ("hang", 0.5)])
def test_a_cell_that_takes_workers_along_is_a_failed_row(task, timeout, dask, tmp_path):
    cells = [*cells_of(task, 1), *cells_of("square", 3)]
    engine = DaskCluster(dask.address)
    outcomes, table = sweep(tmp_path, cells, engine, timeout=timeout)
    assert outcomes[0].failure.startswith(("its worker died", "took longer than 0.5"))
    assert table[1:] == ["7.0", "8.0", "11.0"]


@extras
@slow
@pytest.mark.filterwarnings("ignore")
def test_when_the_scheduler_dies_what_is_done_stays(tmp_path):
    cluster = Cluster(tmp_path)
    cells = cells_of("square", 40, seconds=0.2)
    try:
        with pytest.raises(InputError, match=r"is gone; .* continue with --resume"):
            sweep(
                tmp_path / "run",
                cells,
                DaskCluster(cluster.address),
                on_done=lambda cell, _: (
                    cell.label == "number 3" and cluster.scheduler.kill()
                ),
            )
    finally:
        cluster.stop()
    store = CellStore.of_run(tmp_path / "run")
    assert store.outcome(cells[0]) is not None
    _, table = sweep(tmp_path / "run", cells[:6])
    assert table == [repr(float(value) ** 2 + 7) for value in range(6)]


@extras
@pytest.mark.filterwarnings("ignore")
def test_nobody_at_the_address_is_one_line(monkeypatch):
    monkeypatch.setattr(cluster_module, "CONNECTION_TIME", 0.5)
    with pytest.raises(InputError, match=r"--scheduler tcp://127.0.0.1:9: "):
        DaskCluster("tcp://127.0.0.1:9")


@extras
def test_damaged_certificates_are_one_line(tmp_path):
    file = tmp_path / "ca.pem"
    file.write_text("nothing")
    with pytest.raises(InputError, match=r"--scheduler tls://127.0.0.1:9: "):
        DaskCluster("tls://127.0.0.1:9", TlsFiles(file, file, file))


def test_without_dask_the_extra_is_named(monkeypatch):
    monkeypatch.setattr(cluster_module.importlib.util, "find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"pip install 'pinav\[cluster\]'"):
        DaskCluster("tcp://127.0.0.1:9")


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (ConnectionError("closed"), "the scheduler at a is gone; what is done is kept"),
        (ImportError("no pinav"), "a worker of a cannot load pinav .no pinav."),
    ],
)
def test_errors_of_a_cluster_are_one_line(error, message):
    engine = DaskCluster.__new__(DaskCluster)
    engine.address = "a"
    with pytest.raises(InputError, match=message):
        engine.check_death(error)
    killed = type("KilledWorker", (Exception,), {})
    assert engine.check_death(killed()).pid is None
    with pytest.raises(KeyError):
        engine.check_death(KeyError())
