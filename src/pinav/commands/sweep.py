"""Commands that do many pieces of work: their run, its cells and who does them."""

import contextlib
import dataclasses
import functools
from collections.abc import Iterator, Sequence

import msgspec

from pinav.commands.command import Command
from pinav.commands.results import start_run
from pinav.commands.settings import RunOptions
from pinav.commands.worker_settings import WorkerSettings
from pinav.report import Table, as_text
from pinav.runs import RunFolder
from pinav.sweeps import (
    Cell,
    CellOutcome,
    CellState,
    CellStore,
    OpenCluster,
    SweepStatus,
    TlsFiles,
    claim,
    cluster_at,
    local_cluster,
    map_cells,
)
from pinav.sweeps.store import FOLDER, SWEEP_FILE


@dataclasses.dataclass(frozen=True)
class Sweep:
    """A run of many cells that this process has claimed.

    Attributes:
        folder: of the run.
        open_cluster: gives the workers.
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
        """Do every cell once, and say what became of each, in the order of the table.

        Raises:
            InputError: workers cannot do anything, such as for want of disk.
        """

        def record(cell: Cell, outcome: CellOutcome) -> None:
            del cell, outcome  # one that is done makes the run worth keeping
            name = f"{FOLDER}/{SWEEP_FILE}"
            if name not in self.folder.manifest.entries():
                self.folder.record(name)

        return map_cells(
            cells,
            self.store,
            self.open_cluster,
            timeout=self.timeout,
            title=title,
            on_done=record,
        )


def workers_of(settings: WorkerSettings) -> OpenCluster:
    """The workers that the options ask for.

    One worker, too, is a process: its single thread gives the bytes of all others.
    """
    if settings.scheduler is None:
        return functools.partial(local_cluster, settings.workers)
    tls = None
    if settings.tls_ca and settings.tls_cert and settings.tls_key:
        tls = TlsFiles(settings.tls_ca, settings.tls_cert, settings.tls_key)
    return functools.partial(cluster_at, settings.scheduler, tls)


@contextlib.contextmanager
def start_sweep(
    command: Command,
    options: RunOptions,
    workers: WorkerSettings,
    *settings: msgspec.Struct,
    **identity: str,
) -> Iterator[Sweep]:
    """Claim, create or resume the folder of a run of many cells.

    Args:
        command: what makes the run.
        options: of the command line.
        workers: who does the cells.
        settings: what decides the numbers of the run.
        identity: what else tells this run from others.

    Raises:
        InputError: the folder cannot be used, or another process is at work on it.
    """
    with claim(options.out):
        folder = start_run(command, options, *settings, **identity)
        sweep = Sweep(folder, workers_of(workers), workers.cell_timeout)
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
