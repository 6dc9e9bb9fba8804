"""Benchmarks of many cells: each measurement is a file of its cell."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, TypeVar

import msgspec

from pinav.commands.settings import WorkerSettings
from pinav.commands.sweep import workers_of
from pinav.files import write_text
from pinav.sweeps import Cell, CellStore, claim, map_cells

FILE = "measurement.json"

Kind = TypeVar("Kind", bound=msgspec.Struct)


class SweepOptions(Protocol):
    """What the options of such a benchmark have.

    Attributes:
        out: folder of the results.
        workers: who does the cells.
    """

    @property
    def out(self) -> Path: ...

    @property
    def workers(self) -> WorkerSettings: ...


def write_measurement(folder: Path, measurement: msgspec.Struct) -> None:
    """Keep what was measured in the folder of its cell."""
    write_text(folder / FILE, msgspec.json.encode(measurement).decode())


def measurements(
    cells: Sequence[Cell], kind: type[Kind], options: SweepOptions, title: str
) -> list[Kind]:
    """What was measured in each cell; one that failed is named and left out."""
    store, results = CellStore.of_run(options.out), []
    workers, timeout = workers_of(options.workers), options.workers.cell_timeout
    with claim(options.out):
        outcomes = map_cells(cells, store, workers, timeout=timeout, title=title)
    for cell, outcome in zip(cells, outcomes, strict=True):
        if outcome.failure:
            print(f"{cell.label}: {outcome.failure}", file=sys.stderr)
            continue
        content = (store.folder(cell) / FILE).read_bytes()
        results.append(msgspec.json.decode(content, type=kind))
    return results
