"""Sweeps lose nothing and do nothing twice, whoever works and whatever dies."""

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import msgspec
import pytest
from tests.sweeps.tasks import Number

import pinav.sweeps.attempt
from pinav import __version__
from pinav.errors import InputError
from pinav.sweeps import (
    Cell,
    CellState,
    CellStore,
    InThisProcess,
    LocalProcesses,
    OfExecutor,
    WorkerDeath,
    claim,
    run_sweep,
    sweep_status,
)


def cells_of(task, count, **settings):
    return [
        Cell.of(
            f"tests.sweeps.tasks:{task}",
            Number(float(value), **settings),
            system="none",
            seed=7,
            label=f"number {value}",
        )
        for value in range(count)
    ]


def sweep(run, cells, engine=None, **options):
    """The outcomes, and the table that a command would make of them."""
    engine = engine or InThisProcess()
    store = CellStore.of_run(run)
    try:
        with claim(run):
            outcomes = run_sweep(cells, store, engine, **options)
    finally:
        engine.close()
    files = [store.folder(cell) / "square.txt" for cell in cells]
    table = [file.read_text() if file.exists() else "" for file in files]
    return outcomes, table


def test_a_cell_is_text_and_its_name_is_its_content():
    cell, other = cells_of("square", 2)
    assert Cell.from_text(cell.text) == cell
    assert cell.read(Number) == Number(0.0)
    assert cell.hash != other.hash
    assert cell.name == f"number-0-{cell.hash[:12]}"
    renamed = msgspec.structs.replace(cell, label="/../é", shape="big")
    assert renamed.hash == cell.hash
    assert renamed.name == f"cell-{cell.hash[:12]}"
    assert msgspec.structs.replace(cell, seed=8).hash != cell.hash


def test_every_engine_leaves_the_same_files(tmp_path):
    cells = cells_of("square", 5)
    with ThreadPoolExecutor(2) as threads:
        engines = {
            "here": InThisProcess(),
            "processes": LocalProcesses(2),
            "threads": OfExecutor(threads, 2),
        }
        tables = {}
        for name, engine in engines.items():
            outcomes, tables[name] = sweep(tmp_path / name, cells, engine)
            assert [outcome.failure for outcome in outcomes] == [""] * 5
            store = CellStore.of_run(tmp_path / name)
            left = sorted(path.name for path in store.path.iterdir())
            assert left == sorted([*(cell.name for cell in cells), "sweep.json"])
    assert tables["here"] == tables["processes"] == tables["threads"]
    assert tables["here"][2] == "11.0"


def test_what_is_done_is_not_done_again(tmp_path):
    mark = tmp_path / "mark"
    cells = cells_of("square", 4, mark=str(mark))
    sweep(tmp_path / "run", cells[:2])
    seen = []
    sweep(tmp_path / "run", cells, on_done=lambda cell, _: seen.append(cell.label))
    assert mark.read_text().split("\n")[:-1] == [cell.label for cell in cells]
    assert seen == ["number 2", "number 3"]


@pytest.mark.parametrize(
    ("task", "reason"),
    [("fail", "the fit is singular"), ("stumble", "IndexError: no field")],
)
def test_a_cell_that_fails_says_why_and_is_not_tried_again(task, reason, tmp_path):
    cells = [*cells_of(task, 1), *cells_of("square", 1)]
    outcomes, table = sweep(tmp_path, cells)
    assert [outcome.failure for outcome in outcomes] == [reason, ""]
    assert table == ["", "7.0"]
    assert sweep(tmp_path, cells, LocalProcesses(1))[0] == outcomes


@pytest.mark.parametrize("task", ["crash", "leave"])
def test_a_cell_that_ends_its_worker_three_times_has_failed(task, tmp_path):
    cells = [*cells_of(task, 1), *cells_of("square", 3)]
    outcomes, table = sweep(tmp_path, cells, LocalProcesses(2))
    assert outcomes[0].failure == "its worker died 3 times"
    assert table == ["", "7.0", "8.0", "11.0"]
    assert outcomes[0].again  # by --resume, with a better machine


def test_a_cell_that_hangs_is_ended_and_the_next_client_tries_again(tmp_path):
    cells = [*cells_of("hang", 1), *cells_of("square", 2)]
    outcomes, table = sweep(tmp_path, cells, LocalProcesses(2), timeout=0.5)
    assert outcomes[0].failure == "took longer than 0.5 s"
    assert table[1:] == ["7.0", "8.0"]
    assert not (CellStore.of_run(tmp_path).folder(cells[0]) / "half.txt").exists()
    again, _ = sweep(tmp_path, cells, LocalProcesses(1), timeout=0.2)
    assert again[0].failure == "took longer than 0.2 s"


def test_a_limit_of_time_needs_processes(tmp_path):
    with pytest.raises(InputError, match="cannot be stopped; choose workers that are"):
        sweep(tmp_path, cells_of("square", 1), timeout=1.0)


def test_a_full_disk_stops_the_sweep_and_loses_nothing(tmp_path):
    cells = [*cells_of("square", 1), *cells_of("fill", 1)]
    with pytest.raises(InputError, match=r"No space left.* continue with --resume"):
        sweep(tmp_path, cells)
    store = CellStore.of_run(tmp_path)
    assert store.outcome(cells[0]) is not None
    assert store.outcome(cells[1]) is None
    assert store.attempts(cells[1].name) == []


def test_a_folder_that_cannot_be_written_is_refused_in_one_line():
    with pytest.raises(InputError, match="cannot be written .*choose another folder"):
        sweep(Path("/proc/pinav"), cells_of("square", 1))


def test_a_cell_that_cannot_be_written_stops_the_sweep(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(30, "Read-only file system", "cells/x")

    monkeypatch.setattr(os, "rename", refuse)
    with pytest.raises(InputError, match="cells/x: Read-only file system; then"):
        sweep(tmp_path, cells_of("square", 1))


def test_a_second_client_is_told_in_one_line(tmp_path):
    refusal = pytest.raises(InputError, match="another process is at work")
    with claim(tmp_path / "run"), refusal:
        sweep(tmp_path / "run", cells_of("square", 1))
    assert not (tmp_path / "run").exists()  # claimed, and nothing done


def test_two_attempts_at_once_leave_one_result(tmp_path):
    (cell,) = cells_of("square", 1)
    store = CellStore.of_run(tmp_path)
    store.write_plan([cell], "two")
    first, second = store.begin(cell), store.begin(cell)
    for number, attempt in enumerate((first, second)):
        (attempt / "result" / "square.txt").write_text(str(number))
        outcome = pinav.sweeps.Outcome(float(number))
        store.publish(cell, attempt, outcome)
    assert (store.folder(cell) / "square.txt").read_text() == "0"
    assert store.outcome(cell).seconds == 0.0
    assert store.attempts(cell.name) == []


def test_another_version_is_refused_in_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(pinav.sweeps.attempt, "__version__", "9.9")
    message = f"the client is pinav {__version__}, a worker on .* pinav 9.9; install"
    with pytest.raises(InputError, match=message):
        sweep(tmp_path, cells_of("square", 1))


def test_a_worker_that_does_not_see_the_folder_says_so(tmp_path, monkeypatch):
    """Another machine's folder of the same name holds another sweep."""
    plan = CellStore.write_plan

    def elsewhere(self, cells, engine):
        mine = plan(self, cells, engine)
        plan(self, cells, engine)
        return mine

    monkeypatch.setattr(CellStore, "write_plan", elsewhere)
    monkeypatch.setattr(pinav.sweeps.attempt, "SIGHT", 0.1)
    with pytest.raises(InputError, match="does not see .*all machines share"):
        sweep(tmp_path, cells_of("square", 1))


def test_an_executor_without_workers_ends_the_sweep(tmp_path):
    refusal = pytest.raises(InputError, match="the executor has lost its workers")
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool, refusal:
        sweep(tmp_path, cells_of("leave", 1), OfExecutor(pool, 1))


def test_what_a_cell_prints_is_no_answer(tmp_path):
    assert sweep(tmp_path, cells_of("shout", 2), LocalProcesses(1))[1] == ["0", "0"]


def test_an_error_of_ours_is_no_death(tmp_path):
    for engine in (InThisProcess(), LocalProcesses(1)):
        with pytest.raises(KeyError):
            engine.check_death(KeyError())
        engine.close()
    assert InThisProcess().check_death(WorkerDeath(3)).pid == 3


def test_cells_of_one_shape_go_to_one_worker(tmp_path):
    cells = [
        msgspec.structs.replace(cell, shape=f"{index % 2}")
        for index, cell in enumerate(cells_of("square", 8, seconds=0.05))
    ]
    places = {}

    class Watched(OfExecutor):
        def submit(self, place, version, order):
            cell = Cell.from_text(json.loads(order)["cell"])
            places.setdefault(cell.shape, set()).add(place)
            return super().submit(place, version, order)

    with ThreadPoolExecutor(2) as threads:
        sweep(tmp_path, cells, Watched(threads, 2))
    assert sorted(map(len, places.values())) == [1, 1]


def test_status_is_read_from_files_alone(tmp_path):
    cells = [*cells_of("fail", 1), *cells_of("square", 3)]
    sweep(tmp_path, cells[:2])
    store = CellStore.of_run(tmp_path)
    store.write_plan(cells, "two processes")
    store.begin(cells[2])
    with claim(tmp_path):
        status = sweep_status(tmp_path)
    states = [cell.state for cell in status.cells]
    assert states == [*CellState][::-1][:1] + ["done", "running", "waiting"]
    assert status.cells[0].note == "the fit is singular"
    assert "process" in status.cells[2].note
    assert status.at_work
    alone = sweep_status(tmp_path)
    assert not alone.at_work
    assert alone.cells[2].state == "waiting"


def test_no_sweep_has_no_status(tmp_path):
    with pytest.raises(InputError, match="holds no cells; give the --out of a study"):
        sweep_status(tmp_path)


@pytest.mark.parametrize(("place", "text"), [("sweep.json", "{"), ("cell", "{")])
def test_damaged_files_are_named(place, text, tmp_path):
    cells = cells_of("square", 1)
    sweep(tmp_path, cells)
    store = CellStore.of_run(tmp_path)
    if place == "cell":
        (store.folder(cells[0]) / "outcome.json").write_text(text)
    else:
        (store.path / place).write_text(text)
    with pytest.raises(InputError, match=r"cannot be read .* continue with --resume"):
        sweep_status(tmp_path)


def test_a_damaged_result_of_a_cell_is_named(tmp_path):
    (cell,) = cells_of("square", 1)
    sweep(tmp_path, [cell])
    store = CellStore.of_run(tmp_path)
    (store.folder(cell) / "row.json").write_text("{")
    for name in ("row.json", "absent.json"):
        with pytest.raises(InputError, match=r"cannot be read .* delete .*--resume"):
            store.read_result(cell, name, dict)


def test_a_folder_without_an_outcome_is_damaged(tmp_path):
    (cell,) = cells_of("square", 1)
    store = CellStore.of_run(tmp_path)
    store.folder(cell).mkdir(parents=True)
    with pytest.raises(InputError, match="is damaged; delete it and continue"):
        store.outcome(cell)


def test_cells_are_removed_and_nothing_else(tmp_path):
    cells = cells_of("square", 2)
    sweep(tmp_path, cells)
    store = CellStore.of_run(tmp_path)
    (store.path / "mine").mkdir()
    (store.path / "mine" / "cell.toml").write_text("mine")
    store.remove()
    assert [path.name for path in store.path.iterdir()] == ["mine"]


CLIENT = """
import sys
from pathlib import Path
from tests.sweeps.test_sweep import LocalProcesses, cells_of, sweep
cells = cells_of("square", int(sys.argv[2]), seconds=float(sys.argv[3]))
sweep(Path(sys.argv[1]), cells, LocalProcesses(2))
"""


def start_client(run, count, seconds):
    root = Path(__file__).parents[2]
    words = [sys.executable, "-c", CLIENT, str(run), str(count), str(seconds)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(root), *sys.path])}
    return subprocess.Popen(words, env=environment, start_new_session=True)


def workers_of(client):
    """Processes below a client."""
    command = ["ps", "--ppid", str(client), "-o", "pid=,args="]
    lines = subprocess.run(command, capture_output=True, text=True).stdout.splitlines()
    return [int(line.split()[0]) for line in lines if "pinav.sweeps.worker" in line]


def works(pid):
    """Whether a process runs; one that nobody waits for keeps its number."""
    file = Path(f"/proc/{pid}/cmdline")
    return file.exists() and file.read_bytes() != b""


@pytest.mark.slow
def test_a_client_that_was_killed_goes_on_where_it_was(tmp_path):
    with start_client(tmp_path, 12, 0.3) as client:
        store = CellStore.of_run(tmp_path)
        while len([*store.path.glob("number-*")]) < 3:
            time.sleep(0.05)
        orphans = workers_of(client.pid)
        os.kill(client.pid, signal.SIGKILL)
    assert orphans
    time.sleep(0.5)
    assert not any(map(works, orphans))
    cells = cells_of("square", 12, seconds=0.3)
    done = [cell for cell in cells if store.outcome(cell) is not None]
    seen = []
    _, table = sweep(
        tmp_path, cells, LocalProcesses(2), on_done=lambda cell, _: seen.append(cell)
    )
    assert not set(seen) & set(done)
    assert table == [repr(float(value) ** 2 + 7) for value in range(12)]


@pytest.mark.slow
def test_a_hundred_kills_change_no_byte_of_the_table(tmp_path):
    """Of workers, at random moments, also while they write."""
    cells = cells_of("square", 300, seconds=0.05)
    engine, kills, over = LocalProcesses(2), [], threading.Event()

    def kill():
        dice = random.Random(1)
        while len(kills) < 100 and not over.is_set():
            time.sleep(dice.uniform(0.0, 0.25))
            if pids := workers_of(os.getpid()):
                kills.append(dice.choice(pids))
                with contextlib.suppress(ProcessLookupError):  # it has just ended
                    os.kill(kills[-1], signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    outcomes, table = sweep(tmp_path, cells, engine)
    over.set()
    killer.join()
    assert {outcome.failure for outcome in outcomes} == {""}
    assert table == [repr(float(value) ** 2 + 7) for value in range(300)]
    assert len(kills) >= 50
    assert not [*CellStore.of_run(tmp_path).path.glob(".*")]
