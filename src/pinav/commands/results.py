"""The start of a run, and the way of a result into it, the terminal and the page."""

import hashlib
import sys
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from pinav.codec import encode
from pinav.commands import COMMANDS
from pinav.commands.command import Command, CommandResult, resolve
from pinav.commands.settings import ResumableOptions, RunOptions
from pinav.errors import InputError
from pinav.figures.images import save_pictures
from pinav.learning.learned import Learned
from pinav.reading import Reading
from pinav.report import Code, Image, Section, Table, render, sections_text
from pinav.runs import RunFolder
from pinav.sweeps.store import FOLDER as CELLS
from pinav.trajectories import Trajectories


def start_run(
    command: Command, options: RunOptions, *settings: msgspec.Struct, **identity: str
) -> RunFolder:
    """Create or resume the folder of a run."""
    resume = isinstance(options, ResumableOptions) and options.resume
    if resume and options.overwrite:
        raise InputError("--resume and --overwrite: choose one of them")
    content = []
    for group in settings:
        if isinstance(group, Reading):
            content += [("reading", group.content() or None)]
        else:
            content += msgspec.to_builtins(group, enc_hook=str).items()
    config: dict[str, Any] = {
        key: list(value) if isinstance(value, tuple) else value
        for key, value in content
        if value is not None
    }
    config["run"] = {"command": command.name, **identity}
    if resume:
        return RunFolder.resume(options.out, config)
    return RunFolder.create(
        options.out, config, overwrite=options.overwrite, resumable=command.resumable
    )


def fingerprint(data: Trajectories) -> str:
    """A short hash of the numbers that are fitted."""
    digest = hashlib.sha256()
    for array in (data.times, data.states, data.observed):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:16]


def keep(command: Command, folder: RunFolder, result: Any) -> CommandResult:
    """Store the result of a command in a run, and say what it found.

    Its named tables are written as CSV, too; the document comes last.
    """
    sections: list[Section] = resolve(command.sections)(result)
    for section in sections:
        for block in section.blocks:
            if isinstance(block, Table) and block.name:
                folder.write_table(f"{block.name}.csv", block.header, block.rows)
    folder.store(command.file, result)
    return CommandResult(encode(result).document, sections_text(sections), folder)


def open_fit(path: Path, *, steers: bool = False) -> Learned:
    """Open a fit; a verdict that does not trust it goes to the terminal first.

    Args:
        steers: the force will be steered by.

    Raises:
        InputError: it is to be steered by, and its verdict forbids that.
    """
    fit = Learned.open(path)
    verdict = fit.verdict
    if verdict is None or verdict.is_trusted:
        return fit
    if steers and verdict.forbids_steering:
        raise InputError(
            f"{path}: {verdict.standing}: {verdict.reason}; do not steer by this fit: "
            "mend the system file and fit again, or give --anyway"
        )
    print(f"pinav: {path}: {verdict.says}", file=sys.stderr)
    return fit


def sections_of(command: Command, folder: RunFolder) -> list[Section]:
    """What a command adds to the report of a run; nothing where it did not run."""
    if command.result is None:
        return [] if command.report is None else resolve(command.report)(folder)
    if not folder.has(f"{command.file}.json"):
        return []
    sections = resolve(command.sections)  # imports all classes that a result may have
    return sections(folder.load(command.file, resolve(command.result)))


TABLE = "runs.csv"
"""File of the table of a run of several files."""


def write_report(folder: RunFolder, command: Command | None = None) -> Path:
    """Draw the figures of a finished run and write its `report.html`.

    The sections of the command that made the run come first, then those of every
    command that added results to it.
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
            folder.manifest.check(name)
    content = [
        save_pictures(section, folder.path)
        for command in (maker, *(c for c in COMMANDS if not c.title))
        for section in sections_of(command, folder)
    ]
    versions = folder.read_json("environment.json")
    config = (folder.path / "config.toml").read_text(encoding="utf-8")
    provenance = [
        Section("Configuration", [Code(config)]),
        Section("Versions", [Table(("what", "version"), list(versions.items()))]),
    ]
    subtitle = f"pinav {versions['pinav']}, run {folder.path.name}"
    page = render(maker.title, subtitle, [*content, *provenance])
    folder.write_text("report.html", page)
    images = [b.path for s in content for b in s.blocks if isinstance(b, Image)]
    files = (f for i in map(Path, images) for f in i.parent.glob(f"{i.stem}.*"))
    folder.manifest.record(
        *(file.relative_to(folder.path).as_posix() for file in files)
    )
    return folder.path / "report.html"


def _maker(folder: RunFolder, other: Command | None) -> Command:
    """The command that made the run."""
    name = folder.command
    for command in (*COMMANDS, *([other] if other else [])):
        if command.title and command.name == name:
            return command
    raise InputError(f"{folder.path}/config.toml: command {name!r} is unknown")
