"""`pinav inspect`: what a recording holds and how good it is, before any fit."""

import dataclasses
import json
from pathlib import Path

import numpy as np

from pinav import __version__
from pinav.commands.command import CommandResult
from pinav.commands.data_file import read_data
from pinav.commands.inspect.settings import InspectOptions, RecordingSettings
from pinav.errors import InputError
from pinav.figures import overlay, recording_figure, save_figure
from pinav.figures.style import new_figure
from pinav.files import write_text
from pinav.recordings.quality.report import Quality, Run, Track, quality
from pinav.report import Code, Image, Paragraph, Section, Table, number, render
from pinav.report.text import as_text
from pinav.trajectories import Trajectories

JSON_FILE, PAGE_FILE = "inspection.json", "inspection.html"


def inspect(
    settings: RecordingSettings,
    path: Path,
    out: Path | None = None,
    *,
    image: Path | None = None,
    overwrite: bool = False,
) -> Quality:
    """The quality report of a recording, written into a folder where one is given.

    Args:
        settings: how to read the file.
        path: the file.
        out: folder of `inspection.json`, `inspection.html` and `figures/`.
        image: a still of the film, over which the paths are drawn.
        overwrite: replace a report that is there.

    Raises:
        InputError: the file or the image is damaged, or a report is there already.
    """
    if out is not None and (out / JSON_FILE).exists() and not overwrite:
        raise InputError(f"{out}: holds a report already; give --overwrite or another")
    if image is not None and out is None:
        raise InputError("--image: is drawn into a report; give --out too")
    recording = _with_labels(read_data(path, settings), path)
    found = quality(recording)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        text = json.dumps(found.as_json(), indent=2, allow_nan=False)
        write_text(out / JSON_FILE, text, overwrite=True)
        write_text(out / PAGE_FILE, page(recording, found, out, image), overwrite=True)
    return found


def _with_labels(data: Trajectories, path: Path) -> Trajectories:
    """The positions of a file of pinav as one run, each trajectory a particle.

    Raises:
        InputError: they are not positions in the plane.
    """
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


def text(found: Quality) -> str:
    """The report for a terminal."""
    lines = [f"{found.source}, format {found.format}", "", as_text(runs_table(found))]
    if found.warnings or any(run.warnings for run in found.runs):
        lines += ["", "What a fit cannot tell:", *map(_item, verdicts(found))]
    if found.notes:
        lines += ["", "Notes:", *map(_item, found.notes)]
    return "\n".join(lines)


def _item(words: str) -> str:
    return f"- {words}"


def verdicts(found: Quality) -> list[str]:
    """Each warning once, with the runs that it holds for."""
    runs: dict[str, list[str]] = {}
    for run in found.runs:
        for warning in run.warnings:
            runs.setdefault(warning, []).append(run.name)
    return [*found.warnings, *(_of(names, w, found) for w, names in runs.items())]


def _of(names: list[str], warning: str, found: Quality) -> str:
    if len(found.runs) == 1:
        return warning
    if len(names) == len(found.runs):
        return f"all {len(names)} runs: {warning}"
    shown = ", ".join(names[:4]) + (", ..." if len(names) > 4 else "")
    return f"{len(names)} of {len(found.runs)} runs ({shown}): {warning}"


def runs_table(found: Quality) -> Table:
    """One row for each run."""
    length, time = found.units["x"], found.units["t"]
    header = [
        "run",
        "particles",
        "segments",
        "rows",
        f"duration [{time}]",
        f"rate [1/{time}]",
        "jitter [%]",
        "gaps",
        f"scatter [{length}]",
        f"error [{length}]",
    ]
    driven = any(run.drive for run in found.runs)
    if driven:
        header += ["f [Hz]", "off [%]", "headings", "condition", "delay [%]"]
    return Table(
        header,
        [[*_row(run), *(_drive_cells(run) if driven else [])] for run in found.runs],
        _CAPTION + (_DRIVE_CAPTION if driven else ""),
    )


_CAPTION = (
    "jitter: spread of the intervals; gaps: intervals beyond 1.5 medians; scatter: of "
    "a row from all causes; error: what of it is independent from row to row"
)
_DRIVE_CAPTION = (
    "; off: share of the time; headings: of 12 sectors; condition: of gains and drift, "
    "1 is best; delay: share of its effect that no gain matrix imitates"
)


def _row(run: Run) -> list[str | float | int | None]:
    return [
        run.name,
        run.particles,
        run.segments,
        run.samples,
        run.duration,
        run.clock.rate,
        round(100 * run.clock.jitter, 3),
        run.clock.gaps,
        run.scatter,
        run.deviation,
    ]


def _drive_cells(run: Run) -> list[str | float | int | None]:
    own = run.drive
    if own is None:
        return [None] * 5
    low, high = (number(value, 3) for value in own.frequency)
    return [
        f"{low}–{high}",
        100 * own.off,
        own.sectors,
        "∞" if own.condition == float("inf") else own.condition,
        100 * own.delay,
    ]


def page(
    recording: Trajectories, found: Quality, out: Path, still: Path | None = None
) -> str:
    """The report as one HTML page; its figures are written into `out`."""
    provenance = json.dumps(found.provenance, indent=2, ensure_ascii=False)
    image = save_figure(
        recording_figure(recording, found), out / "figures", "recording"
    )
    sections = [
        Section("What it holds", [runs_table(found), *map(Paragraph, found.notes)]),
        Section(
            "What a fit cannot tell",
            [Paragraph(words) for words in verdicts(found)]
            or [Paragraph("Nothing speaks against a fit of gains, drift and delay.")],
        ),
        Section("At a glance", [Image(image.png, "Four panels", _caption(found))]),
        *([] if still is None else [_on_image(recording, still, out)]),
        *_speed_sections(found),
        Section("Particles", [_tracks_table(found)]),
        Section("How it was read", [Code(provenance)]),
    ]
    return render(f"Recording {found.source}", f"pinav {__version__}", sections)


def _on_image(recording: Trajectories, still: Path, out: Path) -> Section:
    import matplotlib.image

    try:
        pixels = matplotlib.image.imread(still)
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(f"{still}: cannot be read as an image: {error}") from error
    figure = new_figure(6.0, 5.0)
    overlay(recording, np.asarray(pixels), figure.add_subplot())
    image = save_figure(figure, out / "figures", "overlay")
    caption = "Paths over a still of the film, in its pixels; a ring at each start."
    return Section("In the image", [Image(image.png, "Paths on the image", caption)])


def _caption(found: Quality) -> str:
    driven = any(run.speeds for run in found.runs)
    second = (
        "(b) median speed over half a second at each commanded frequency; the band "
        "holds 80 % where there is one run; "
        if driven
        else "(b) median speed over half a second; "
    )
    last = (
        "(d) commanded frequency and heading."
        if driven
        else "(d) scatter of a row from all causes, and what of it is independent from "
        "row to row, the localisation error."
    )
    return (
        "(a) Paths, y up, a mark at each start; segments are not joined; "
        f"{second}(c) intervals between rows; {last}"
    )


def _speed_sections(found: Quality) -> list[Section]:
    unit = f"{found.units['x']}/{found.units['t']}"
    rows = [
        (run.name, s.frequency, s.median, s.low, s.high, s.windows)
        for run in found.runs
        for s in run.speeds
    ]
    if not rows:
        return []
    header = ("run", "f [Hz]", f"median [{unit}]", "10 %", "90 %", "windows")
    caption = "Speed over half a second, while the frequency changed by less than 10 %."
    return [Section("Speed against frequency", [Table(header, rows, caption)])]


def _tracks_table(found: Quality) -> Table:
    length, time = found.units["x"], found.units["t"]
    rows = [
        (
            track.run,
            track.particle,
            track.segments,
            track.samples,
            track.lost,
            track.duration,
            track.path,
            track.speed,
            *_localised(track),
        )
        for track in found.tracks
    ]
    header = (
        "run",
        "particle",
        "segments",
        "rows",
        "lost",
        f"duration [{time}]",
        f"path [{length}]",
        f"speed [{length}/{time}]",
        f"scatter [{length}]",
        f"error [{length}]",
        f"D [{length}²/{time}]",
    )
    caption = "D: diffusion or jitter, as far as error and motion leave it."
    return Table(header, rows, caption)


def _localised(track: Track) -> list[float | None]:
    own = track.localisation
    return [None] * 3 if own is None else [own.scatter, own.deviation, own.diffusion]


def run(options: InspectOptions) -> CommandResult:
    """Inspect as the command line does."""
    report = inspect(
        options.settings,
        options.file,
        options.out,
        image=options.image,
        overwrite=options.overwrite,
    )
    page = None if options.out is None else options.out / PAGE_FILE
    return CommandResult(report.as_json(), text(report), page=page)
