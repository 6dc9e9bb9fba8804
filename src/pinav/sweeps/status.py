"""How far a sweep is, from its files alone; any process may ask."""

import enum
import time
from pathlib import Path

import msgspec

from pinav.errors import InputError
from pinav.sweeps.store import CellStore, is_claimed


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
