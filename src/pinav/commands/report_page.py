"""Figures and the HTML page of a run, from its saved results alone."""

from pathlib import Path

from pinav.commands import COMMANDS
from pinav.commands.command import Command, resolve
from pinav.errors import InputError
from pinav.files import write_text
from pinav.report import Code, Section, Table, render
from pinav.runs import RunFolder


def write_report(folder: RunFolder) -> Path:
    """Draw the figures of a finished run and write its `report.html`.

    The sections of the command that made the run come first, then those of every
    command that added results to it.

    Raises:
        InputError: the run is not finished, or one of its files is damaged.
    """
    if not folder.has("metrics.json"):
        raise InputError(
            f"{folder.path} is not finished; go on with --resume, then report"
        )
    maker = _maker(folder)
    additions = [c for c in COMMANDS if c.report is not None and not c.title]
    content = [
        section
        for command in (maker, *additions)
        for section in resolve(str(command.report))(folder)
    ]
    page = render(maker.title, _subtitle(folder), [*content, *_provenance(folder)])
    path = folder.path / "report.html"
    write_text(path, page, overwrite=True)
    return path


def _maker(folder: RunFolder) -> Command:
    """The command that made the run."""
    name = folder.command
    for command in COMMANDS:
        if command.title and command.name == name:
            return command
    raise InputError(f"{folder.path}/config.toml: command {name!r} is unknown")


def _subtitle(folder: RunFolder) -> str:
    environment = folder.read_json("environment.json")
    return f"pinav {environment['pinav']}, run {folder.path.name}"


def _provenance(folder: RunFolder) -> list[Section]:
    environment = folder.read_json("environment.json")
    config = (folder.path / "config.toml").read_text(encoding="utf-8")
    return [
        Section("Configuration", [Code(config)]),
        Section("Versions", [Table(("what", "version"), list(environment.items()))]),
    ]
