"""A command of the command line, as a value."""

from __future__ import annotations

import dataclasses
import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    from pinav.runs import RunFolder


@dataclasses.dataclass(frozen=True)
class Command:
    """Everything that the command line and the report need to know of one command.

    Parts that import numerical libraries are named as "module:name" and imported when
    they are used, so that help is quick.

    Attributes:
        name: the word after `pinav`.
        summary: its line in the list of commands.
        options: the struct that tyro parses.
        run: the function that takes these options and returns a `CommandResult`.
        title: heading of the report of the runs that it makes; empty where it makes
            none.
        report: the function that takes a run folder and returns the sections that this
            command adds to the report of a run; none for a command that adds none.
        result: the class of what it stores in a run; none where it stores nothing so.
        file: name of the files of the result, without ending.
        sections: the function that takes this result and returns the sections that a
            terminal and the report show.
        resumable: a killed run can be continued with `--resume`.
        compiler_flags: XLA compiles the large programs of this command faster with the
            flags of `pinav.numerics.compiler_flags`.
        call: the words of a shell that call it, where it is not `pinav` and its name.
    """

    name: str
    summary: str
    options: str
    run: str
    title: str = ""
    report: str | None = None
    result: str | None = None
    file: str = "metrics"
    sections: str = ""
    resumable: bool = False
    compiler_flags: bool = True
    call: str = ""

    @property
    def words(self) -> str:
        """The words of a shell that call it."""
        return self.call or f"pinav {self.name}"


@dataclasses.dataclass(frozen=True)
class CommandResult:
    """What a command has done.

    Attributes:
        metrics: numbers for scripts: a struct or builtin values, printed with `--json`.
        folder: of the run whose report is to be written; none where there is no run.
        page: a report that the command has written itself.
    """

    metrics: Any
    text: str
    folder: RunFolder | None = None
    page: Path | None = None


def resolve(reference: str) -> Any:
    """Import what "module:name" refers to."""
    module, _, name = reference.partition(":")
    return getattr(importlib.import_module(module), name)
