"""One run for each of several files, and one table of them all."""

import hashlib
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import tomli_w

from pinav.commands.command import Command, CommandResult, resolve
from pinav.commands.report_page import TABLE, write_report
from pinav.commands.sweep import Sweep, start_sweep
from pinav.commands.worker_settings import FilesOptions
from pinav.errors import InputError
from pinav.report import Table, as_text
from pinav.runs import METRICS_FILE
from pinav.sweeps import Cell, CellOutcome

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
        settings: the other options, as TOML.
    """

    options: str
    run: str
    digest: str
    settings: str


def run_files(command: Command, options: FilesOptions) -> CommandResult:
    """One run for each file; those that are done are not done again.

    Raises:
        InputError: a file is missing or given twice, or the folder cannot be used.
    """
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
        blank = [["" if cell is None else cell for cell in line] for line in lines]
        sweep.folder.write_table(TABLE, header, blank)
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
    settings = tomli_w.dumps(_without_none(content))
    return Cell.of(
        "pinav.commands.many_files:do_file",
        FileCell(command.options, command.run, digest, settings),
        system=str(path.absolute()),
        label=path.name,
    )


def _without_none(content: Any) -> Any:
    """The content without entries that TOML cannot hold."""
    if not isinstance(content, dict):
        return content
    return {k: _without_none(v) for k, v in content.items() if v is not None}


def do_file(cell: Cell, folder: Path) -> None:
    """Run the command on one file, in the folder of the cell.

    Raises:
        FitError: the fit failed.
        InputError: the file is damaged or holds something else.
    """
    one = cell.read(FileCell)
    content = tomllib.loads(one.settings) | {"data": [cell.system], "out": str(folder)}
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
    metrics = sweep.store.read_result(cell, METRICS_FILE, dict)
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
