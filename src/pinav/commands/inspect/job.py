"""`pinav inspect`: what a recording holds and how good it is, before any fit."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import tomli_w

from pinav import __version__
from pinav.codec import encode
from pinav.commands.command import CommandResult
from pinav.commands.data_file import read_data
from pinav.commands.inspect import InspectOptions
from pinav.errors import InputError
from pinav.figures import overlay_figure, recording_figure
from pinav.figures.images import save_pictures
from pinav.files import write_text
from pinav.fitting import judge_increments
from pinav.recordings.conventions import in_words
from pinav.recordings.drive import Drive
from pinav.recordings.quality import Quality, Run, Track, quality
from pinav.report import (
    Cell,
    Code,
    Paragraph,
    Section,
    Table,
    number,
    render,
    sections_text,
)
from pinav.trajectories import Trajectories

JSON_FILE, PAGE_FILE = "inspection.json", "inspection.html"
READING_FILE = "reading.toml"
"""How the file was read, for `--reading` of other commands."""


def run(options: InspectOptions) -> CommandResult:
    """Inspect a recording, and write the report where a folder is given."""
    settings, path, out = options.settings, options.file, options.out
    if out is not None and (out / JSON_FILE).exists() and not options.overwrite:
        raise InputError(f"{out}: holds a report already; give --overwrite or another")
    if options.image is not None and out is None:
        raise InputError("--image: is drawn into a report; give --out too")
    recording = _with_labels(read_data(path, settings, doubtful=True), path)
    report = _with_verdict(quality(recording), recording)
    document, written = encode(report).document, None
    if out is not None:
        content = json.dumps(document, indent=2, allow_nan=False)
        html = page(recording, report, out, options.image)  # makes the folder
        log = settings.commands  # as it is called in every folder
        settings = msgspec.structs.replace(settings, commands=log and log.absolute())
        how = tomli_w.dumps(settings.content())
        write_text(out / READING_FILE, how, overwrite=True)
        write_text(out / JSON_FILE, content, overwrite=True)
        written = out / PAGE_FILE
        write_text(written, html, overwrite=True)
    return CommandResult(document, text(report), page=written)


def _with_verdict(report: Quality, recording: Trajectories) -> Quality:
    """The report with a note on thermal motion, where a recording may show it."""
    if recording.commands or "x" not in recording.channels:
        return report
    axes = [name for name in ("x", "y", "z") if name in recording.channels]
    positions = recording.only(axes)
    if not (positions.observed.all(axis=2).sum(axis=1) > FEWEST).any():
        return report
    verdict = judge_increments(positions)
    if not verdict.is_thermal:
        return report
    return dataclasses.replace(report, notes=[*report.notes, verdict.statement])


FEWEST = 100
"""Samples of one trajectory from which on correlations of increments say something."""


def _with_labels(data: Trajectories, path: Path) -> Trajectories:
    """The positions of a file of pinav as one run, each trajectory a particle."""
    if {"trajectories", "concatenated"} & set(data.provenance):
        return data
    if data.channels[:2] != ("x", "y") or "z" in data.channels:
        raise InputError(
            f"{path}: expected positions x and y in the plane, got "
            f"{', '.join(data.channels)}; inspect reads nothing else"
        )
    labels = [
        {"run": path.stem, "particle": index, "segment": 0}
        for index in range(len(data))
    ]
    said = {"source": path.name, "format": "pinav", "trajectories": labels}
    return dataclasses.replace(data.only(("x", "y")), provenance=said)


def text(report: Quality) -> str:
    """The report for a terminal."""
    said = in_words(report.provenance)
    head = [f"{report.source}, format {report.format}"]
    head += [f"read as: {'; '.join(said)}"] if said else []
    return "\n".join([*head, "", sections_text(verdict_sections(report))])


def verdict_sections(report: Quality) -> list[Section]:
    """What is to be settled, what the recording holds, and what a fit cannot tell."""
    doubts = [Section("To be settled before a fit", [*map(Paragraph, report.doubts)])]
    limits = verdicts(report) or [
        "Nothing speaks against a fit of gains, drift and delay."
    ]
    return [
        *(doubts if report.doubts else []),
        Section("What it holds", [runs_table(report), *map(Paragraph, report.notes)]),
        Section("What a fit cannot tell", [*map(Paragraph, limits)]),
    ]


def verdicts(report: Quality) -> list[str]:
    """Each warning once, with the runs that it holds for."""
    runs: dict[str, list[str]] = {}
    for run in report.runs:
        for warning in run.warnings:
            runs.setdefault(warning, []).append(run.name)
    return [*report.warnings, *(_of(names, w, report) for w, names in runs.items())]


def _of(names: list[str], warning: str, report: Quality) -> str:
    if len(report.runs) == 1:
        return warning
    if len(names) == len(report.runs):
        return f"all {len(names)} runs: {warning}"
    shown = ", ".join(names[:4]) + (", ..." if len(names) > 4 else "")
    return f"{len(names)} of {len(report.runs)} runs ({shown}): {warning}"


def runs_table(report: Quality) -> Table:
    """One row for each run."""
    length, time = report.units["x"], report.units["t"]
    columns: dict[str, Callable[[Run], Cell]] = {
        "run": lambda run: run.name,
        "particles": lambda run: run.particles,
        "segments": lambda run: run.segments,
        "rows": lambda run: run.samples,
        f"duration [{time}]": lambda run: run.duration,
        f"rate [1/{time}]": lambda run: run.clock.rate,
        "jitter [%]": lambda run: round(100 * run.clock.jitter, 3),
        "gaps": lambda run: run.clock.gaps,
        f"scatter [{length}]": lambda run: run.scatter,
        f"error [{length}]": lambda run: run.deviation,
    }
    if not any(run.drive for run in report.runs):
        return Table.of(report.runs, columns, _CAPTION)
    return Table.of(report.runs, columns | _DRIVE_COLUMNS, _CAPTION + _DRIVE_CAPTION)


_CAPTION = (
    "jitter: spread of the intervals; gaps: intervals beyond 1.5 medians; scatter: of "
    "a row from all causes; error: what of it is independent from row to row"
)
_DRIVE_CAPTION = (
    "; off: share of the time; headings: of 12 sectors; condition: of gains and drift, "
    "1 is best; raw: the same of columns that are not normalised; axis: share of the "
    "driven time within 10 degrees of one axis; delay: share of its effect that no "
    "gain matrix imitates"
)


def _of_drive(cell: Callable[[Drive], Cell]) -> Callable[[Run], Cell]:
    """A cell of a run that was driven, and an empty one of others."""
    return lambda run: None if run.drive is None else cell(run.drive)


def _or_infinite(condition: float) -> Cell:
    return "∞" if condition == float("inf") else condition


_DRIVE_COLUMNS = {
    "f [Hz]": _of_drive(lambda d: "–".join(number(f, 3) for f in d.frequency)),
    "off [%]": _of_drive(lambda drive: 100 * drive.off),
    "headings": _of_drive(lambda drive: drive.sectors),
    "condition": _of_drive(lambda drive: _or_infinite(drive.condition)),
    "raw": _of_drive(lambda drive: _or_infinite(drive.raw_condition)),
    "axis [%]": _of_drive(lambda drive: 100 * drive.aligned),
    "delay [%]": _of_drive(lambda drive: 100 * drive.delay),
}


def page(
    recording: Trajectories, report: Quality, out: Path, still: Path | None = None
) -> str:
    """The report as one HTML page; its figures are written into `out`."""
    provenance = json.dumps(report.provenance, indent=2, ensure_ascii=False)
    sections = [
        *verdict_sections(report),
        Section("At a glance", [recording_figure(recording, report)]),
        *([] if still is None else [_on_image(recording, still)]),
        *_speed_sections(report),
        Section("Particles", [_tracks_table(report)]),
        Section("How it was read", [Code(provenance)]),
    ]
    saved = [save_pictures(section, out) for section in sections]
    return render(f"Recording {report.source}", f"pinav {__version__}", saved)


def _on_image(recording: Trajectories, still: Path) -> Section:
    import matplotlib.image

    try:
        pixels = matplotlib.image.imread(still)
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(f"{still}: cannot be read as an image: {error}") from error
    return Section("In the image", [overlay_figure(recording, np.asarray(pixels))])


def _speed_sections(report: Quality) -> list[Section]:
    unit = f"{report.units['x']}/{report.units['t']}"
    rows = [
        (run.name, s.frequency, s.median, s.low, s.high, s.windows)
        for run in report.runs
        for s in run.speeds
    ]
    if not rows:
        return []
    header = ("run", "f [Hz]", f"median [{unit}]", "10 %", "90 %", "windows")
    caption = "Speed over half a second, while the frequency changed by less than 10 %."
    return [Section("Speed against frequency", [Table(header, rows, caption)])]


def _tracks_table(report: Quality) -> Table:
    length, time = report.units["x"], report.units["t"]
    columns: dict[str, Callable[[Track], Cell]] = {
        "run": lambda track: track.run,
        "particle": lambda track: track.particle,
        "segments": lambda track: track.segments,
        "rows": lambda track: track.samples,
        "lost": lambda track: track.lost,
        f"duration [{time}]": lambda track: track.duration,
        f"path [{length}]": lambda track: track.path,
        f"speed [{length}/{time}]": lambda track: track.speed,
        f"scatter [{length}]": _localisation("scatter"),
        f"error [{length}]": _localisation("deviation"),
        f"D [{length}²/{time}]": _localisation("diffusion"),
    }
    caption = "D: diffusion or jitter, as far as error and motion leave it."
    return Table.of(report.tracks, columns, caption)


def _localisation(name: str) -> Callable[[Track], Cell]:
    """A number of the localisation, where there is one."""
    return lambda track: getattr(track.localisation, name, None)
