"""The start of a run, and the way of a result into it, the terminal and the page."""

import hashlib
from typing import Any

import msgspec
import numpy as np

from pinav.codec import encode
from pinav.commands.command import Command, CommandResult, resolve
from pinav.commands.settings import ResumableOptions, RunOptions
from pinav.errors import InputError
from pinav.report import Section, Table
from pinav.report.text import sections_text
from pinav.runs import RunFolder
from pinav.trajectories import Trajectories


def start_run(
    command: Command, options: RunOptions, *settings: msgspec.Struct, **identity: str
) -> RunFolder:
    """Create or resume the folder of a run.

    Args:
        command: what makes the run.
        options: of the command line.
        settings: what decides the numbers of the run.
        identity: what else tells this run from others, such as a hash of its data.

    Raises:
        InputError: the folder cannot be used, or holds a run with other settings.
    """
    resume = isinstance(options, ResumableOptions) and options.resume
    if resume and options.overwrite:
        raise InputError("--resume and --overwrite: choose one of them")
    content = [
        item for s in settings for item in msgspec.to_builtins(s, enc_hook=str).items()
    ]
    config: dict[str, Any] = {
        key: list(value) if isinstance(value, tuple) else value
        for key, value in content
        if value is not None
    }
    config["run"] = {"command": command.name, **identity}
    if resume:
        return RunFolder.resume(options.out, config)
    return RunFolder.create(
        options.out,
        config,
        overwrite=options.overwrite,
        resumable=command.resumable,
    )


def fingerprint(data: Trajectories) -> str:
    """A short hash of the numbers that are fitted."""
    digest = hashlib.sha256()
    for array in (data.times, data.states, data.observed):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:16]


def keep(command: Command, folder: RunFolder, result: Any) -> CommandResult:
    """Store the result of a command in a run, and say what it found.

    Its named tables are written as CSV, too, where a number that is not defined leaves
    its cell empty; the document comes last.
    """
    sections: list[Section] = resolve(command.sections)(result)
    for section in sections:
        for block in section.blocks:
            if isinstance(block, Table) and block.name:
                rows = [[None if c != c else c for c in row] for row in block.rows]
                folder.write_table(f"{block.name}.csv", block.header, rows)
    folder.store(command.file, result)
    return CommandResult(encode(result).document, sections_text(sections), folder)


def sections_of(command: Command, folder: RunFolder) -> list[Section]:
    """What a command adds to the report of a run; nothing where it did not run.

    Raises:
        InputError: its files are damaged.
    """
    if command.result is None:
        return [] if command.report is None else resolve(command.report)(folder)
    if not folder.has(f"{command.file}.json"):
        return []
    sections = resolve(command.sections)  # imports all classes that a result may have
    return sections(folder.load(command.file, resolve(command.result)))
