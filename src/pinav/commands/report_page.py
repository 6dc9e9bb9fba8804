"""Figures and the HTML page of a run, from its saved results alone."""

from collections.abc import Sequence
from pathlib import Path

from pinav.commands import COMMANDS
from pinav.commands.command import Command
from pinav.commands.results import sections_of
from pinav.errors import InputError
from pinav.figures.images import Figures
from pinav.report import Code, Image, Section, Table, render
from pinav.runs import RunFolder
from pinav.sweeps.store import FOLDER as CELLS

TABLE = "runs.csv"
"""File of the table of a run of several files."""


def write_report(folder: RunFolder, command: Command | None = None) -> Path:
    """Draw the figures of a finished run and write its `report.html`.

    The sections of the command that made the run come first, then those of every
    command that added results to it.

    Args:
        folder: The run.
        command: What made or extended it, where that is none of `COMMANDS`.

    Raises:
        InputError: the run is not finished, or one of its files is damaged.
    """
    maker = _maker(folder, command)
    if folder.has(TABLE):
        raise InputError(
            f"{folder.path} holds the runs of several files; report one of those in "
            f"{folder.path / CELLS}"
        )
    if not folder.has("metrics.json"):
        advice = "continue it with --resume" if maker.resumable else "repeat it"
        raise InputError(f"{folder.path} is not finished; {advice}, then report")
    for name in folder.manifest.entries():
        if name.endswith((".eqx", ".npz")) and not name.startswith("checkpoint-"):
            folder.check_file(name)
    figures = Figures(folder.path)
    content = [
        figures.saved(section)
        for command in (maker, *(c for c in COMMANDS if not c.title))
        for section in sections_of(command, folder)
    ]
    page = render(maker.title, _subtitle(folder), [*content, *_provenance(folder)])
    folder.write_text("report.html", page)
    images = [b.path for s in content for b in s.blocks if isinstance(b, Image)]
    folder.record(*_figures(folder, images))
    return folder.path / "report.html"


def _figures(folder: RunFolder, images: Sequence[str | Path]) -> list[str]:
    """Names of the figures that were drawn, in all of their formats."""
    return [
        file.relative_to(folder.path).as_posix()
        for image in images
        for file in Path(image).parent.glob(f"{Path(image).stem}.*")
    ]


def _maker(folder: RunFolder, other: Command | None) -> Command:
    """The command that made the run."""
    name = folder.command
    for command in (*COMMANDS, *([other] if other else [])):
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
