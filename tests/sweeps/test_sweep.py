"""Sweeps lose nothing and do nothing twice, whoever works and whatever dies."""

import contextlib
import json
import os
from pathlib import Path

import msgspec
import pytest
from tests.sweeps.here import Client, here
from tests.sweeps.tasks import Number

import pinav.sweeps.attempt
from pinav import __version__, sweeps
from pinav.errors import InputError


def cells_of(task, count, **settings):
    return [
        sweeps.Cell.of(
            f"tests.sweeps.tasks:{task}",
            Number(float(value), **settings),
            system="none",
            seed=7,
            label=f"number {value}",
        )
        for value in range(count)
    ]


def sweep(run, cells, workers=here, **options):
    """The outcomes, and the table that a command would make of them."""
    store = sweeps.CellStore.of_run(run)
    with sweeps.claim(run):
        outcomes = sweeps.map_cells(cells, store, workers, **options)
    files = [store.folder(cell) / "square.txt" for cell in cells]
    table = [file.read_text() if file.exists() else "" for file in files]
    return outcomes, table


def test_a_cell_is_text_and_its_name_is_its_content():
    cell, other = cells_of("square", 2)
    assert sweeps.Cell.from_text(cell.text) == cell
    assert cell.read(Number) == Number(0.0)
    assert cell.hash != other.hash
    assert cell.name == f"number-0-{cell.hash[:12]}"
    renamed = msgspec.structs.replace(cell, label="/../é", shape="big")
    assert renamed.hash == cell.hash
    assert renamed.name == f"cell-{cell.hash[:12]}"
    assert msgspec.structs.replace(cell, seed=8).hash != cell.hash


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
    assert sweep(tmp_path, cells)[0] == outcomes


@pytest.mark.parametrize(
    ("count", "words", "failure"),
    [
        (3, "Fatal Python error: Segmentation fault", "its worker died 3 times"),
        (2, "Fatal Python error: Segmentation fault", ""),
        (20, "", "its worker was killed 20 times"),
        (19, "", ""),
        (1, "Timeout (0:00:01)!", "took longer than its time"),
    ],
)
def test_what_died_attempts_left_decides_whether_a_cell_is_tried(
    count, words, failure, tmp_path
):
    (cell,) = cells_of("square", 1)
    store = sweeps.CellStore.of_run(tmp_path)

    class Dying(Client):
        def submit(self, function, version, order, **_):
            for _ in range(count):
                (store.begin(cell) / "trace.txt").write_text(words)
            return super().submit(function, version, order)

    (outcome,), table = sweep(tmp_path, [cell], lambda: here(Dying()))
    assert outcome.failure == failure
    assert table == (["7.0"] if not failure else [""])
    assert outcome.again == bool(failure)  # by --resume, with a better machine
    assert not store.attempts(cell.name)


def test_a_worker_that_is_gone_gives_its_cell_back(tmp_path):
    class Vanishing(Client):
        count = 0

        def scheduler_info(self, **_):
            self.count += 1
            return {"workers": {f"worker {self.count}": {}}}

        def submit(self, function, version, order, **_):
            future = super().submit(function, version, order)
            future.status = ["pending", "finished"][self.count > 2]
            future.cancel = lambda: None
            return future

    gone = sweeps.Cluster(Vanishing(), "some")
    gone.wait = lambda futures, seconds: None
    outcomes, table = sweep(
        tmp_path, cells_of("square", 1), lambda: contextlib.nullcontext(gone)
    )
    assert table == ["7.0"]
    assert outcomes[0].failure == ""


def test_a_limit_of_time_needs_processes(tmp_path):
    with pytest.raises(InputError, match="cannot be stopped; choose workers that are"):
        sweep(tmp_path, cells_of("square", 1), timeout=1.0)


def test_a_full_disk_stops_the_sweep_and_loses_nothing(tmp_path):
    cells = [*cells_of("square", 1), *cells_of("fill", 1)]
    with pytest.raises(InputError, match=r"No space left.* continue with --resume"):
        sweep(tmp_path, cells)
    store = sweeps.CellStore.of_run(tmp_path)
    assert store.outcome(cells[0]) is not None
    assert store.outcome(cells[1]) is None
    assert store.attempts(cells[1].name) == []


def test_a_folder_that_cannot_be_written_is_refused_in_one_line(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="cannot be written .*choose another folder"):
        sweep(Path("/proc/pinav"), cells_of("square", 1))

    def refuse(*_):
        raise OSError(30, "Read-only file system", "cells/x")

    monkeypatch.setattr(os, "rename", refuse)
    with pytest.raises(InputError, match="cells/x: Read-only file system; then"):
        sweep(tmp_path, cells_of("square", 1))


def test_a_second_client_is_told_in_one_line(tmp_path):
    refusal = pytest.raises(InputError, match="another process is at work")
    with sweeps.claim(tmp_path / "run"), refusal:
        sweep(tmp_path / "run", cells_of("square", 1))
    assert not (tmp_path / "run").exists()  # claimed, and nothing done


def test_two_attempts_at_once_leave_one_result(tmp_path):
    (cell,) = cells_of("square", 1)
    store = sweeps.CellStore.of_run(tmp_path)
    store.write_plan([cell], "two")
    first, second = store.begin(cell), store.begin(cell)
    for number, attempt in enumerate((first, second)):
        (attempt / "result" / "square.txt").write_text(str(number))
        outcome = pinav.sweeps.CellOutcome(float(number))
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
    plan = sweeps.CellStore.write_plan

    def elsewhere(self, cells, engine):
        mine = plan(self, cells, engine)
        plan(self, cells, engine)
        return mine

    monkeypatch.setattr(sweeps.CellStore, "write_plan", elsewhere)
    monkeypatch.setattr(pinav.sweeps.attempt, "SIGHT", 0.1)
    with pytest.raises(InputError, match="does not see .*all machines share"):
        sweep(tmp_path, cells_of("square", 1))


def test_cells_of_one_shape_go_to_one_worker(tmp_path):
    cells = [
        msgspec.structs.replace(cell, shape=f"{index % 2}")
        for index, cell in enumerate(cells_of("square", 8, seconds=0.05))
    ]
    places = {}

    class Two(Client):
        def scheduler_info(self, **_):
            return {"workers": {"one": {}, "other": {}}}

        def submit(self, function, version, order, workers, **_):
            cell = sweeps.Cell.from_text(json.loads(order)["cell"])
            places.setdefault(cell.shape, set()).update(workers)
            return super().submit(function, version, order)

    sweep(tmp_path, cells, lambda: here(Two()))
    assert sorted(map(len, places.values())) == [1, 1]


def test_status_is_read_from_files_alone(tmp_path):
    cells = [*cells_of("fail", 1), *cells_of("square", 3)]
    sweep(tmp_path, cells[:2])
    store = sweeps.CellStore.of_run(tmp_path)
    store.write_plan(cells, "two processes")
    store.begin(cells[2])
    with sweeps.claim(tmp_path):
        status = sweeps.sweep_status(tmp_path)
    states = [cell.state for cell in status.cells]
    assert states == [*sweeps.CellState][::-1][:1] + ["done", "running", "waiting"]
    assert status.cells[0].note == "the fit is singular"
    assert "process" in status.cells[2].note
    assert status.at_work
    alone = sweeps.sweep_status(tmp_path)
    assert not alone.at_work
    assert alone.cells[2].state == "waiting"


def test_no_sweep_has_no_status(tmp_path):
    with pytest.raises(InputError, match="holds no cells; give the --out of a study"):
        sweeps.sweep_status(tmp_path)


@pytest.mark.parametrize("name", ["sweep.json", "outcome.json"])
def test_damaged_files_are_named(name, tmp_path):
    (cell,) = cells_of("square", 1)
    sweep(tmp_path, [cell])
    store = sweeps.CellStore.of_run(tmp_path)
    folder = store.path if name == "sweep.json" else store.folder(cell)
    (folder / name).write_text("{")
    with pytest.raises(InputError, match=r"cannot be read .* continue with --resume"):
        sweeps.sweep_status(tmp_path)
    (store.folder(cell) / "outcome.json").unlink()
    with pytest.raises(InputError, match="is damaged; delete it and continue"):
        store.outcome(cell)


def test_cells_are_removed_and_nothing_else(tmp_path):
    cells = cells_of("square", 2)
    sweep(tmp_path, cells)
    store = sweeps.CellStore.of_run(tmp_path)
    (store.path / "mine").mkdir()
    (store.path / "mine" / "cell.toml").write_text("mine")
    store.remove()
    assert [path.name for path in store.path.iterdir()] == ["mine"]
