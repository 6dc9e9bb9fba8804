"""The options that say who does many pieces of work; they decide no number."""

from pathlib import Path
from typing import Annotated

import tyro

from pinav.commands.settings import Range, ResumableOptions, Settings


class WorkerSettings(Settings, frozen=True):
    """Who does the cells of a sweep: docs/scale.md.

    Attributes:
        workers: Processes of this machine that work side by side, or the address of a
            Dask scheduler that runs, such as tcp://host:8786, whose workers share
            --out.
        cell_timeout: Seconds after which one piece of work counts as failed.
    """

    workers: Annotated[int | str, Range(1), tyro.conf.arg(metavar="N|ADDRESS")] = 1
    cell_timeout: Annotated[float | None, Range(above=0)] = None


ALONE = WorkerSettings()
"""This process does the work; of several cells, a process of this machine."""


class FilesOptions(ResumableOptions, frozen=True, kw_only=True):
    """The options of a command that makes a run of one file, or of each of several.

    Attributes:
        data: The file; of several, each gets a run below --out, and all one table.
        workers: Who makes the runs of several files.
    """

    data: Annotated[tuple[Path, ...], tyro.conf.Positional]
    workers: WorkerSettings = ALONE

    @property
    def file(self) -> Path | None:
        """The only file, where this process makes its run."""
        single = len(self.data) == 1 and self.workers == ALONE
        return self.data[0] if single else None
