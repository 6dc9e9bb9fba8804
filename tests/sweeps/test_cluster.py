"""Sweeps on Dask: on a local cluster, and by a scheduler that runs.

Workers that are killed, crash and hang lose nothing and change no byte.
"""

import contextlib
import functools
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import psutil
import pytest
from dask import config
from tests.sweeps.here import Client
from tests.sweeps.test_sweep import cells_of, sweep

from pinav.errors import InputError
from pinav.sweeps import CellStore, Cluster, cluster_at, local_cluster
from pinav.sweeps import cluster as cluster_module

pytestmark = pytest.mark.filterwarnings("ignore")  # of Dask
slow = pytest.mark.slow


class Scheduler:
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
        return json.loads(file.read_text())["address"]

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
    cluster = Scheduler(tmp_path_factory.mktemp("dask"))
    yield cluster
    cluster.stop()


@slow
def test_a_cluster_leaves_the_table_of_this_process(dask, tmp_path):
    cells = cells_of("square", 6)
    workers = functools.partial(cluster_at, dask.address)
    outcomes, table = sweep(tmp_path / "dask", cells, workers)
    assert {outcome.failure for outcome in outcomes} == {""}
    assert table == sweep(tmp_path / "here", cells)[1]


@slow
@pytest.mark.parametrize("where", ["local", "cluster"])
def test_cells_that_take_workers_along_are_failed_rows(where, dask, tmp_path, capfd):
    tasks = ("crash", "hang", "shout", "fail")
    cells = [cell for task in tasks for cell in cells_of(task, 1)]
    cells += cells_of("square", 3)
    workers = functools.partial(
        *((local_cluster, 2) if where == "local" else (cluster_at, dask.address))
    )
    outcomes, table = sweep(tmp_path, cells, workers, timeout=1.0)
    assert [outcome.failure for outcome in outcomes[:4]] == [
        "its worker died 3 times",
        "took longer than 1 s",
        "",
        "the fit is singular",
    ]
    assert table[4:] == ["7.0", "8.0", "11.0"]
    assert not (CellStore.of_run(tmp_path).folder(cells[1]) / "half.txt").exists()
    assert "this is no answer" not in capfd.readouterr().out
    assert not [*CellStore.of_run(tmp_path).path.glob(".*")]


@slow
def test_when_the_scheduler_dies_what_is_done_stays(tmp_path):
    cluster = Scheduler(tmp_path)
    cells = cells_of("square", 40, seconds=0.2)
    try:
        with pytest.raises(InputError, match=r"is gone; .* continue with --resume"):
            sweep(
                tmp_path / "run",
                cells,
                functools.partial(cluster_at, cluster.address),
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


CLIENT = """
import sys
from functools import partial
from pathlib import Path
from pinav.sweeps import local_cluster
from tests.sweeps.test_sweep import cells_of, sweep
if __name__ == "__main__":
    cells = cells_of("square", 12, seconds=0.3)
    try:
        sweep(Path(sys.argv[1]), cells, partial(local_cluster, 2))
    except KeyboardInterrupt:
        sys.exit(130)
"""


@slow
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_client_that_was_ended_leaves_no_worker_and_goes_on(how, tmp_path):
    (tmp_path / "client.py").write_text(CLIENT)
    root, store = Path(__file__).parents[2], CellStore.of_run(tmp_path / "run")
    command = [sys.executable, str(tmp_path / "client.py"), str(tmp_path / "run")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(root), *sys.path])}
    with subprocess.Popen(
        command, env=environment, start_new_session=True, stderr=subprocess.PIPE
    ) as client:
        while len([*store.path.glob("number-*")]) < 3:
            time.sleep(0.05)
        workers = psutil.Process(client.pid).children(recursive=True)
        os.killpg(client.pid, how) if how == signal.SIGINT else client.kill()
        _, errors = client.communicate(timeout=60)
    assert workers
    assert b"Traceback" not in errors, errors.decode()
    psutil.wait_procs(workers, timeout=20)
    assert not [one for one in workers if one.is_running()]
    cells, seen = cells_of("square", 12, seconds=0.3), []
    done = [cell for cell in cells if store.outcome(cell) is not None]
    _, table = sweep(tmp_path / "run", cells, on_done=lambda cell, _: seen.append(cell))
    assert not set(seen) & set(done)
    assert table == [repr(float(value) ** 2 + 7) for value in range(12)]


@slow
def test_many_kills_change_no_byte_of_the_table(tmp_path):
    """Of workers of this machine, at random moments, also while they write."""
    cells = cells_of("square", 300, seconds=0.05)
    kills, over = [], threading.Event()

    def kill():
        dice = random.Random(1)
        while len(kills) < 30 and not over.is_set():
            time.sleep(dice.uniform(0.0, 1.0))
            if pids := workers_of(CellStore.of_run(tmp_path)):
                kills.append(dice.choice(pids))
                with contextlib.suppress(ProcessLookupError):  # it has just ended
                    os.kill(kills[-1], signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    outcomes, table = sweep(tmp_path, cells, functools.partial(local_cluster, 2))
    over.set()
    killer.join()
    assert {outcome.failure for outcome in outcomes} == {""}
    assert table == [repr(float(value) ** 2 + 7) for value in range(300)]
    assert len(kills) >= 10
    assert not [*CellStore.of_run(tmp_path).path.glob(".*")]


def workers_of(store):
    """Processes that are at work on a cell, or were."""
    attempts = (store.start_of(path) for path in store.path.glob(".*.tmp"))
    return [start.pid for start in attempts if start is not None]


def test_nobody_there_and_damaged_certificates_are_one_line(monkeypatch, tmp_path):
    monkeypatch.setattr(cluster_module, "CONNECTION_TIME", 0.5)
    refusal = pytest.raises(InputError, match=r"--workers tcp://127.0.0.1:9: ")
    with refusal, cluster_at("tcp://127.0.0.1:9"):
        pass
    file = tmp_path / "ca.pem"
    file.write_text("nothing")
    tls = "distributed.comm.tls"
    names = (f"{tls}.ca-file", f"{tls}.client.cert", f"{tls}.client.key")
    refusal = pytest.raises(InputError, match=r"--workers tls://127.0.0.1:9: ")
    with (
        config.set(dict.fromkeys(names, str(file))),
        refusal,
        cluster_at("tls://127.0.0.1:9"),
    ):
        pass


def test_a_cluster_that_is_gone_and_what_became_of_a_cell_elsewhere():
    client = Client()
    client.status = "closed"
    with pytest.raises(InputError, match="scheduler of a is gone; what is done is"):
        Cluster(client, "a").workers()
    cluster, future = Cluster(Client(), "a"), Failed("error", KilledWorker())
    assert cluster.answer(future) is None
    assert cluster.answer(Failed("lost", None)) is None
    with pytest.raises(InputError, match="a worker of a cannot load pinav .no pinav."):
        cluster.answer(Failed("error", ImportError("no pinav")))
    with pytest.raises(KeyError):
        cluster.answer(Failed("error", KeyError()))


class KilledWorker(Exception):
    """As Dask calls a worker that died several times."""


class Failed:
    """A future without an answer."""

    def __init__(self, status, error):
        self.status, self.error = status, error

    def exception(self):
        return self.error
