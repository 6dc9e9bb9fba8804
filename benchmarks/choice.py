"""Errors and bands of the chosen model on many tracks, each split several times.

Run with `python -m benchmarks choice`. Tracks of at least 40 s stand in alphabetical
order: the even ones are for development, the odd ones judge what was chosen on those.
Sessions are split at 30, 50 and 70 % of their time, other tracks at 50 and 70 %; of the
large groups every second one of a half is taken. Splits that were done are kept in the
folder.
"""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import msgspec
import numpy as np
import tyro

from benchmarks._options import begin, read_kept
from pinav.commands.settings import Settings
from pinav.errors import FitError, InputError
from pinav.files import write_text
from pinav.identification import (
    Rollouts,
    Track,
    coverage,
    select_model,
    tracks,
)
from pinav.identification.findings import BEYOND
from pinav.identification.selection import LEAST_SQUARES, STACKED
from pinav.recordings import read_recording


class Group(NamedTuple):
    """Recordings of one kind of robot.

    Attributes:
        file: within the folder of recordings.
        step: of the tracks of a half every so many are taken.
        splits: shares of the time that train.
    """

    file: str
    step: int = 1
    splits: tuple[float, ...] = (0.5, 0.7)


GROUPS = {
    "sessions": Group("magscope_cellbot_sessions/sessions.csv.gz", 1, (0.3, 0.5, 0.7)),
    "dimers": Group("magscope_speed_vs_freq/5um_dimer.csv.gz"),
    "cellbots": Group("magscope_speed_vs_freq/cellbot.csv.gz", 2),
    "rollers of 20 um": Group("magscope_speed_vs_freq/20um_roller.csv.gz", 2),
    "rollers of 5 um": Group("magscope_speed_vs_freq/5um_roller.csv.gz", 2),
}
"""Recordings that are split."""

SHORTEST = 40.0
"""Duration below which a track is left out [s]."""

HORIZON = 10.0
"""Length of the rollouts [s]."""


class Options(Settings, frozen=True):
    """Judge what `identify` chooses on one half of the recordings."""

    folder: Annotated[
        Path, tyro.conf.arg(help="Folder of the recordings; searched for files.")
    ] = Path(os.environ.get("PINAV_RECORDINGS", "../shared/data"))
    half: Annotated[
        Literal["development", "judged"], tyro.conf.arg(help="Which tracks.")
    ] = "development"
    groups: Annotated[
        tuple[str, ...], tyro.conf.arg(help="Names of the groups that are taken.")
    ] = tuple(GROUPS)
    out: Annotated[Path, tyro.conf.arg(help="Folder of the results.")] = Path(
        "runs/bench-choice"
    )

    def check_together(self) -> None:
        """Raise `InputError` where a group is unknown."""
        for name in self.groups:
            if name not in GROUPS:
                raise InputError(
                    f"--groups: expected some of {', '.join(GROUPS)}; got {name!r}"
                )


class Split(msgspec.Struct, frozen=True):
    """What one split of a track gave.

    Attributes:
        group: name of its group.
        track: its name.
        train_fraction: share of its time that trained.
        chosen: name of the model.
        error: median error of rollouts over their path; None without rollouts.
        least_squares: the same of least squares.
        stacked: the same of the average of both.
        inside: share of held-out coordinates in bands of 90 %; None without rollouts.
        rollouts: their number.
        faster: whether the test part exceeds the training part in frequency.
    """

    group: str
    track: str
    train_fraction: float
    chosen: str
    error: float | None
    least_squares: float | None
    stacked: float | None
    inside: float | None
    rollouts: int
    faster: bool


def main(argv: Sequence[str]) -> None:
    options = begin(Options, argv, "choice")
    if options is None:
        return
    options.out.mkdir(parents=True, exist_ok=True)
    rows: list[Split] = []
    for name in options.groups:
        for track in half_of(options.folder, GROUPS[name], options.half):
            for fraction in GROUPS[name].splits:
                rows += judge(track, fraction, name, options.out)
    print(HEADER)
    for name in options.groups:
        print(line(name, [row for row in rows if row.group == name]))
    print(line("all", rows))
    print(line("all, test part faster", [row for row in rows if row.faster]))


def half_of(folder: Path, group: Group, half: str) -> list[Track]:
    """Tracks of a half of a group, in alphabetical order."""
    several = tracks(read_recording(folder / group.file))
    several = [track for track in several if track.duration >= SHORTEST]
    several.sort(key=lambda track: track.name)
    return several[int(half == "judged") :: 2 * group.step]


def judge(track: Track, fraction: float, group: str, out: Path) -> list[Split]:
    """The row of a split, computed unless kept; none where a part is too short."""
    label = f"{group} {track.name} {fraction}".replace("/", "-").replace(" ", "-")
    kept = out / f"{label}.json"
    if kept.is_file():
        return [read_kept(kept, Split)]
    try:
        selection = select_model(track, train_fraction=fraction)
    except (InputError, FitError) as error:
        print(f"{label}: {error}")
        return []
    predictor = selection.predictor
    rollouts = Rollouts.of(selection.held_out, HORIZON)
    bands = coverage(selection.held_out, rollouts, predictor)
    fastest = max(p.commands["frequency"].max() for p in selection.held_out.pieces)
    errors = [
        selection.row(name).over(HORIZON)
        for name in (selection.chosen, LEAST_SQUARES, STACKED)
    ]
    ours, theirs, both = (
        e.relative if e is not None and e.rollouts else None for e in errors
    )
    row = Split(
        group=group,
        track=track.name,
        train_fraction=fraction,
        chosen=selection.chosen,
        error=ours,
        least_squares=theirs,
        stacked=both,
        inside=bands.inside if bands.rollouts else None,
        rollouts=bands.rollouts,
        faster=bool(fastest > BEYOND * predictor.fastest),
    )
    write_text(kept, msgspec.json.encode(row).decode() + "\n", overwrite=True)
    print(f"{label}: {row.chosen}, {row.error}, {row.inside}", flush=True)
    return [row]


HEADER = (
    f"{'':<24}{'splits':>7}{'rollouts':>9}{'error':>7}{'least sq.':>10}{'ratio':>7}"
    f"{'worse':>7}{'stacked':>9}{'worse':>7}{'in 90 %':>9}\n"
    "error: median over splits; worse: splits on which it exceeds least squares by 10 %"
    "; stacked: the average with least squares"
)


def line(name: str, rows: list[Split]) -> str:
    """A row of the table; splits without rollouts or least squares are left out."""
    whole = [
        row for row in rows if None not in (row.error, row.least_squares, row.stacked)
    ]
    if not whole:
        return f"{name:<24}{0:>7}"
    ours = np.array([row.error for row in whole], float)
    theirs = np.array([row.least_squares for row in whole], float)
    both = np.array([row.stacked for row in whole], float)
    counts = np.array([row.rollouts for row in whole])
    inside = float(counts @ np.array([row.inside for row in whole], float))
    error, baseline = np.median(ours), np.median(theirs)
    return (
        f"{name:<24}{len(whole):>7}{counts.sum():>9}{error:>7.3f}{baseline:>10.3f}"
        f"{error / baseline:>7.2f}{(ours > 1.1 * theirs).sum():>7}"
        f"{np.median(both):>9.3f}{(both > 1.1 * theirs).sum():>7}"
        f"{inside / counts.sum():>9.1%}"
    )
