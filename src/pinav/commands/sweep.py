"""Commands that do many pieces of work: their run, its cells and who does them."""

import contextlib
import dataclasses
import functools
import hashlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from pinav.commands.command import Command, CommandResult, resolve
from pinav.commands.results import TABLE, start_run, write_report
from pinav.commands.settings import FilesOptions, RunOptions, WorkerSettings
from pinav.errors import InputError
from pinav.reading import Content
from pinav.report import Table, as_text
from pinav.runs import METRICS_FILE, RunFolder
from pinav.sweeps import (
    Cell,
    CellOutcome,
    CellState,
    CellStore,
    OpenCluster,
    SweepStatus,
    claim,
    cluster_at,
    local_cluster,
    map_cells,
)
from pinav.sweeps.store import FOLDER, SWEEP_FILE

Result = TypeVar("Result")

FILE = "result"
"""File of the result of a cell, without ending."""


@dataclasses.dataclass(frozen=True)
class Sweep:
    """A run of many cells that this process has claimed.

    Attributes:
        timeout: seconds that a cell may take; none for no limit.
    """

    folder: RunFolder
    open_cluster: OpenCluster
    timeout: float | None = None

    @property
    def store(self) -> CellStore:
        """The cells of the run."""
        return CellStore.of_run(self.folder.path)

    def run(self, cells: Sequence[Cell], title: str) -> list[CellOutcome]:
        """Do every cell once; what became of each, in the order of the table."""

        def record(cell: Cell, outcome: CellOutcome) -> None:
            del cell, outcome  # one that is done makes the run worth keeping
            name = f"{FOLDER}/{SWEEP_FILE}"
            if name not in self.folder.manifest.entries():
                self.folder.manifest.record(name)

        return map_cells(
            cells,
            self.store,
            self.open_cluster,
            timeout=self.timeout,
            title=title,
            on_done=record,
        )

    def result(self, cell: Cell, wanted: type[Result]) -> Result:
        """The result that a cell stored as its `FILE`.

        Raises:
            InputError: it failed, was not done, or is damaged.
        """
        outcome = self.store.outcome(cell)
        if outcome is None or outcome.failure:
            reason = "it was not done" if outcome is None else outcome.failure
            raise InputError(f"{cell.label}: {reason}")
        folder = self.store.folder(cell)
        try:
            return RunFolder(folder).load(FILE, wanted)
        except InputError as error:
            raise InputError(
                f"{error}, or delete {folder} and continue with --resume"
            ) from error


def workers_of(settings: WorkerSettings) -> OpenCluster:
    """The workers that the options ask for.

    One worker, too, is a process: its single thread gives the bytes of all others.
    """
    workers = settings.workers
    if isinstance(workers, int):
        return functools.partial(local_cluster, workers)
    if "://" not in workers:
        raise InputError(
            "--workers: expected a number, or the address of a scheduler such as "
            f"tcp://host:8786, got {workers!r}"
        )
    return functools.partial(cluster_at, workers)


@contextlib.contextmanager
def start_sweep(
    command: Command,
    options: RunOptions,
    workers: WorkerSettings,
    *settings: msgspec.Struct,
    **identity: str,
) -> Iterator[Sweep]:
    """Claim, create or resume the folder of a run of many cells."""
    open_cluster = workers_of(workers)
    with claim(options.out):
        folder = start_run(command, options, *settings, **identity)
        sweep = Sweep(folder, open_cluster, workers.cell_timeout)
        if options.overwrite:
            sweep.store.remove()
        yield sweep


def status_text(status: SweepStatus) -> str:
    """The table of cells for a terminal, and how long it will take."""
    rows = [
        (cell.label, str(cell.state), _duration(cell.seconds), cell.note)
        for cell in status.cells
    ]
    table = Table(("cell", "state", "time", "note"), rows)
    total, done = len(rows), status.count(CellState.DONE)
    failed = status.count(CellState.FAILED)
    fraction = (done + failed) / max(total, 1)
    bar = "#" * round(BAR * fraction) + "." * round(BAR * (1 - fraction))
    left = "" if status.left is None else f", about {_duration(status.left)} left"
    work = f"at work: {status.engine}{left}" if status.at_work else NOBODY
    if done + failed == total:
        work = "complete"
    counts = f"{done + failed} of {total} cells, {failed} failed"
    return "\n".join([as_text(table), f"[{bar}] {counts}; {work}"])


BAR = 30
"""Characters of the bar of progress."""

NOBODY = "nobody is at work on it: continue with --resume"


def _duration(seconds: float | None) -> str:
    if seconds is None:
        return ""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d} min" if minutes else f"{seconds:.1f} s"


NOT_OF_THE_CELL = ("data", "out", "overwrite", "json", "config", "resume", "workers")
"""Options that do not decide what becomes of one file."""

SHOWN = 8
"""Columns that a terminal gets; the file has all of them."""


class FileCell(msgspec.Struct, frozen=True):
    """What decides the run of one file beside its path.

    Attributes:
        options: "module:name" of the options of the command.
        run: "module:name" of its function.
        digest: SHA-256 of the file.
        settings: the other options.
    """

    options: str
    run: str
    digest: str
    settings: Content


def run_files(command: Command, options: FilesOptions) -> CommandResult:
    """One run for each file; those that are done are not done again."""
    if not options.data:
        raise InputError("expected a file of data, got none; give one or more")
    cells = [_cell(command, options, path) for path in options.data]
    names = [cell.system for cell in cells]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{name} is given twice; drop one")
    digest = hashlib.sha256("".join(cell.hash for cell in cells).encode()).hexdigest()
    with start_sweep(command, options, options.workers, files=digest[:16]) as sweep:
        outcomes = sweep.run(cells, command.name)
        rows = tuple(map(_row, cells, outcomes, [sweep] * len(cells)))
        header = list(dict.fromkeys(name for row in rows for name in row))
        lines = [[row.get(name) for name in header] for row in rows]
        sweep.folder.write_table(TABLE, header, lines)
        shown = Table(header[:SHOWN], [line[:SHOWN] for line in lines])
        text = f"{as_text(shown)}\ntable: {sweep.folder.path / TABLE}"
        return CommandResult({"files": rows}, text)


def _cell(command: Command, options: FilesOptions, path: Path) -> Cell:
    try:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror}") from error
    content = msgspec.to_builtins(options, enc_hook=str)
    for name in NOT_OF_THE_CELL:
        content.pop(name)
    return Cell.of(
        "pinav.commands.sweep:do_file",
        FileCell(command.options, command.run, digest, content),
        system=str(path.absolute()),
        label=path.name,
    )


def do_file(cell: Cell, folder: Path) -> None:
    """Run the command on one file, in the folder of the cell."""
    one = cell.read(FileCell)
    content = one.settings | {"data": [cell.system], "out": str(folder)}
    options = msgspec.convert(
        content, resolve(one.options), dec_hook=lambda kind, value: kind(value)
    )
    result = resolve(one.run)(options)
    write_report(result.folder)


def _row(
    cell: Cell, outcome: CellOutcome, sweep: Sweep
) -> dict[str, str | float | None]:
    folder = sweep.store.folder(cell)
    place = folder.relative_to(sweep.folder.path).as_posix()
    row: dict[str, str | float | None] = {"file": cell.label, "run": place}
    if outcome.failure:
        return row | {"failure": outcome.failure}
    metrics = RunFolder(folder).read_json(METRICS_FILE)
    return row | {"failure": None} | dict(_numbers(metrics.get("value", metrics)))


def _numbers(content: Any, names: Sequence[str] = ()) -> list[tuple[str, Any]]:
    """Numbers and words of nested tables, by the words on the way to them."""
    if isinstance(content, dict):
        return [
            pair
            for name, value in content.items()
            for pair in _numbers(value, (*names, name))
        ]
    plain = content is None or isinstance(content, str | int | float)
    return [(" ".join(names), content)] if plain else []
