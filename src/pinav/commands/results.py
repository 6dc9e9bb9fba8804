"""The way of a result: into its run, onto the terminal, into the report."""

from typing import Any

from pinav.codec import encode
from pinav.commands.command import Command, CommandResult, resolve
from pinav.report import Section, Table
from pinav.report.text import sections_text
from pinav.runs import RunFolder


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
    result = folder.load(command.file, resolve(command.result))
    return resolve(command.sections)(result)
