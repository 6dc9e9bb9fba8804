"""The shared part of what commands take: strict structs, readable as TOML.

Only settings decide the numbers of a run; where it is written does not belong to them.
This module imports no numerical library, so that `--help` is quick.
"""

from pathlib import Path
from typing import Annotated

import tyro
from tyro.constructors import PrimitiveConstructorSpec

from pinav.learning.recipes import MaxSteps as MaxSteps
from pinav.learning.recipes import ModelName as ModelName
from pinav.reading import PLAIN, Reading
from pinav.settings import MAX_STEPS as MAX_STEPS
from pinav.settings import Numbers as Numbers
from pinav.settings import Range as Range
from pinav.settings import Settings as Settings
from pinav.settings import Several as Several
from pinav.settings import numbers as numbers

SystemName = Annotated[
    str | None,
    tyro.conf.arg(
        help="What is known of the swimmer: a system file (.toml), module.py:name, or "
        "the name of a built-in system such as paper. The system that the data were "
        "simulated from unless given."
    ),
]
AsJson = Annotated[
    bool,
    tyro.conf.arg(help="Print the metrics as JSON, for scripts, and nothing else."),
]
ReadingWords = Annotated[
    Reading,
    PrimitiveConstructorSpec(
        nargs="*",
        metavar="NAME=VALUE|FILE",
        instance_from_str=Reading.of_words,
        is_instance=lambda value: isinstance(value, Reading),
        str_from_instance=lambda value: [] if value == PLAIN else ["as in --config"],
    ),
    tyro.conf.arg(
        help="A recording: what its file does not say, as for pinav inspect, such as "
        "fps=10 mpp=0.5 y=up units.heading=rad columns.x=X; or the file reading.toml "
        "that pinav inspect writes."
    ),
]
"""How a recording is read, in commands that take one."""


class RunOptions(Settings, frozen=True, kw_only=True):
    """The options of every command that makes a run.

    Attributes:
        out: Folder of the run.
        overwrite: Replace the results that --out already holds.
    """

    out: Path
    overwrite: bool = False
    json: AsJson = False


class ResumableOptions(RunOptions, frozen=True, kw_only=True):
    """The options of every command whose run can be continued.

    Attributes:
        config: TOML file with settings; options on the command line override it.
        resume: Continue the run in --out where it was interrupted.
    """

    config: Path | None = None
    resume: bool = False


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
