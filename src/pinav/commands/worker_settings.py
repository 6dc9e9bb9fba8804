"""The options that say who does many pieces of work; they decide no number."""

from pathlib import Path
from typing import Annotated

import tyro

from pinav.commands.settings import Range, ResumableOptions, Settings
from pinav.errors import InputError


class WorkerSettings(Settings, frozen=True):
    """Who does the cells of a sweep: docs/scale.md.

    Attributes:
        workers: Processes of this machine that work side by side.
        scheduler: Address of a Dask scheduler that runs, such as tcp://host:8786; its
            workers do the work and share --out.
        tls_ca: Certificate of the authority that client and cluster trust.
        tls_cert: Certificate of this client.
        tls_key: Private key of this client.
        cell_timeout: Seconds after which one piece of work counts as failed.
    """

    workers: Annotated[int, Range(1)] = 1
    scheduler: str | None = None
    tls_ca: Path | None = None
    tls_cert: Path | None = None
    tls_key: Path | None = None
    cell_timeout: Annotated[float | None, Range(above=0)] = None

    def check_together(self) -> None:
        if self.scheduler is not None and self.workers != 1:
            raise InputError("--workers and --scheduler: choose one of them")
        files = (self.tls_ca, self.tls_cert, self.tls_key)
        given = [file for file in files if file is not None]
        if given and (self.scheduler is None or len(given) < len(files)):
            raise InputError(
                "--tls-ca, --tls-cert and --tls-key: give all three, with --scheduler"
            )
        for file in given:
            if not file.is_file():
                raise InputError(f"{file}: expected a file of a certificate or key")


class FilesOptions(ResumableOptions, frozen=True, kw_only=True):
    """The options of a command that makes a run of one file, or of each of several.

    Attributes:
        data: The file; of several, each gets a run below --out, and all one table.
        workers: Who makes the runs of several files.
    """

    data: Annotated[tuple[Path, ...], tyro.conf.Positional]
    workers: WorkerSettings = WorkerSettings()

    def check_together(self) -> None:
        if not self.data:
            raise InputError("expected a file of data, got none; give one or more")
        if len(self.data) == 1 and self.workers != WorkerSettings():
            raise InputError(
                "--workers and the options beside it are for several files; drop them"
            )
