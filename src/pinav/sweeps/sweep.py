"""The client of a sweep: hands out what is not done, and once more what is lost.

How far a sweep is, any process may ask: its files alone tell it.
"""

import enum
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import msgspec
from tqdm import tqdm

from pinav import __version__
from pinav.errors import InputError
from pinav.sweeps.attempt import Order, process_name
from pinav.sweeps.cluster import Cluster
from pinav.sweeps.store import Cell, CellOutcome, CellStore, is_claimed

PAUSE = 0.5
"""How often a client looks for new workers [s]."""


OpenCluster = Callable[[], AbstractContextManager[Cluster]]
"""Starts workers, or finds them, and lets them go at the end."""


def map_cells(
    cells: Sequence[Cell],
    store: CellStore,
    open_cluster: OpenCluster,
    *,
    timeout: float | None = None,
    title: str = "cells",
    on_done: Callable[[Cell, CellOutcome], None] = lambda cell, outcome: None,
) -> list[CellOutcome]:
    """Do every cell once; those that the store holds are done.

    The caller holds the folder (`claim`). Without a cell to do, no worker is started.

    Args:
        on_done: told of each cell when it is done now.

    Returns:
        One outcome for each cell, in the order of the table.

    Raises:
        InputError: workers cannot do anything, such as for want of disk.
        OSError: the folder cannot be written.
    """
    waiting = [cell for cell in dict.fromkeys(cells) if _is_undone(cell, store)]
    with tqdm(
        total=len(cells),
        initial=len(cells) - len(waiting),
        desc=title,
        unit="cell",
        dynamic_ncols=True,
    ) as bar:
        if waiting:
            with open_cluster() as cluster:
                token = store.write_plan(cells, cluster.description).token
                sweep = _Sweep(waiting, store, cluster, token, timeout)
                while sweep.waiting or sweep.running:
                    sweep.hand_out()
                    for cell, outcome in sweep.collect():
                        bar.set_postfix_str(cell.label, refresh=False)
                        bar.update()
                        on_done(cell, outcome)
    outcomes = [store.outcome(cell) for cell in cells]
    return [outcome for outcome in outcomes if outcome is not None]


def _is_undone(cell: Cell, store: CellStore) -> bool:
    """True if a cell is to be done; attempts of a client that died do not count."""
    outcome = store.outcome(cell)
    store.forget(cell)
    if outcome is not None and outcome.again:
        store.discard(cell)
    return outcome is None or outcome.again


class _Sweep:
    """What waits and what runs."""

    def __init__(
        self,
        waiting: list[Cell],
        store: CellStore,
        cluster: Cluster,
        token: str,
        timeout: float | None,
    ) -> None:
        self.waiting, self.store, self.cluster = waiting, store, cluster
        self.token, self.timeout = token, timeout
        self.running: dict[str, tuple[Any, Cell]] = {}
        self.shapes: dict[str, str] = {}

    def hand_out(self) -> None:
        """Give each free worker a cell; take back what a worker had that is gone."""
        places = self.cluster.workers()
        for place in self.running.keys() - set(places):
            future, cell = self.running[place]
            if future.status == "pending":
                del self.running[place]
                future.cancel()
                self.waiting.append(cell)  # last: others need not wait for its crashes
        for place in places:
            if place not in self.running and self.waiting:
                cell = self.waiting.pop(self._choose(place))
                self.shapes[place] = cell.shape
                future = self.cluster.submit(place, __version__, self._order(cell))
                self.running[place] = future, cell

    def _choose(self, place: str) -> int:
        """A cell of the shape that the worker has compiled, else of one nobody has."""
        mine = self.shapes.get(place)
        others = {shape for where, shape in self.shapes.items() if where != place}
        shapes = [cell.shape for cell in self.waiting]
        if mine in shapes:
            return shapes.index(mine)
        new = (index for index, shape in enumerate(shapes) if shape not in others)
        return next(new, 0)

    def _order(self, cell: Cell) -> str:
        order = Order(
            cells=str(self.store.path.absolute()),
            token=self.token,
            cell=cell.text,
            client=process_name(),
            timeout=self.timeout,
        )
        return msgspec.json.encode(order).decode()

    def collect(self) -> list[tuple[Cell, CellOutcome]]:
        """Wait a little; the cells that are done since."""
        if not self.running:
            time.sleep(PAUSE)  # for a worker to come
            return []
        self.cluster.wait([future for future, _ in self.running.values()], PAUSE)
        results = []
        for place, (future, cell) in list(self.running.items()):
            if future.status != "pending":
                del self.running[place]
                outcome = self._settle(future, cell)
                if outcome is None:
                    self.waiting.append(cell)
                else:
                    results.append((cell, outcome))
        return results

    def _settle(self, future: Any, cell: Cell) -> CellOutcome | None:
        """What became of a cell; none where its worker was lost."""
        refusal = self.cluster.answer(future)
        if refusal is None:
            return None
        if refusal:
            raise InputError(f"{refusal}; then continue with --resume")
        return self.store.wait_for(cell)


class CellState(enum.StrEnum):
    """What is true of a cell now."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"


class CellLine(msgspec.Struct, frozen=True):
    """One cell.

    Attributes:
        folder: where its files are, below the run.
        seconds: that it took, or has been running for.
        note: where it runs, or why it failed.
    """

    label: str
    folder: str
    state: CellState
    seconds: float | None = None
    note: str = ""


class SweepStatus(msgspec.Struct, frozen=True):
    """How far a sweep is.

    Attributes:
        cells: one line for each cell, in the order of the table.
        at_work: a client is at work.
        left: estimate of the time until the end [s]; none before a cell is done.
    """

    cells: tuple[CellLine, ...]
    engine: str
    at_work: bool
    left: float | None = None

    def count(self, state: CellState) -> int:
        """How many cells are in a state."""
        return sum(cell.state is state for cell in self.cells)


def sweep_status(run: Path) -> SweepStatus:
    """How far the sweep of a run is.

    Raises:
        InputError: the folder holds no sweep.
    """
    store = CellStore.of_run(run)
    plan = store.read_plan()
    if plan is None:
        raise InputError(
            f"{run} holds no cells; give the --out of a study, or of several files"
        )
    at_work = is_claimed(run)
    cells = tuple(
        _line(store, name, label, at_work=at_work) for name, label in plan.cells.items()
    )
    return SweepStatus(cells, plan.engine, at_work, _time_left(cells))


def _line(store: CellStore, name: str, label: str, *, at_work: bool) -> CellLine:
    folder = store.path.name + "/" + name
    outcome = store.outcome_of(name)
    if outcome is not None:
        state = CellState.FAILED if outcome.failure else CellState.DONE
        return CellLine(label, folder, state, outcome.seconds, outcome.failure)
    starts = [store.start_of(attempt) for attempt in store.attempts(name)]
    known = [start for start in starts if start is not None]
    if not at_work or not known:
        return CellLine(label, folder, CellState.WAITING)
    last = max(known, key=lambda start: start.since)
    since = max(0.0, time.time() - last.since)  # the clocks of machines may differ
    place = f"on {last.host}, process {last.pid}"
    return CellLine(label, folder, CellState.RUNNING, since, place)


def _time_left(cells: tuple[CellLine, ...]) -> float | None:
    """Mean time of the cells that are done, over those that run side by side."""
    done = [c.seconds for c in cells if c.state is CellState.DONE and c.seconds]
    running = sum(cell.state is CellState.RUNNING for cell in cells)
    left = running / 2 + sum(cell.state is CellState.WAITING for cell in cells)
    return sum(done) / len(done) * left / max(running, 1) if done else None
