"""`read_recording`: a tracker's file, whatever its format, as `Trajectories`."""

import dataclasses
import os
from collections.abc import Mapping, Sequence

from pinav.errors import InputError
from pinav.recordings.assembly import assemble
from pinav.recordings.command_log import read_log, with_commands
from pinav.recordings.formats.column_map import MappedTable
from pinav.recordings.formats.deeplabcut import DeepLabCut
from pinav.recordings.formats.described import DESCRIBED
from pinav.recordings.formats.format import AbstractFormat
from pinav.recordings.formats.geff import Geff
from pinav.recordings.formats.icy import Icy
from pinav.recordings.formats.idtracker import IdTracker
from pinav.recordings.formats.imagej import ImageJ
from pinav.recordings.formats.magscope import MagScope
from pinav.recordings.formats.matlab import Matlab
from pinav.recordings.formats.mtrackj import MTrackJ
from pinav.recordings.formats.sfi import SFI
from pinav.recordings.formats.sleap import Sleap
from pinav.recordings.formats.tidy import Tidy
from pinav.recordings.formats.trackmate import TrackMateCSV, TrackMateXML
from pinav.recordings.formats.trackmate_project import TrackMateProject
from pinav.recordings.formats.trackpy import Trackpy
from pinav.recordings.formats.trex import TRex
from pinav.recordings.formats.utrack import UTrack
from pinav.recordings.layout import Layout
from pinav.recordings.rows import COMMAND_UNITS, Reading
from pinav.recordings.source import DataFrame, Source
from pinav.recordings.synonyms import example_of_columns, likely_columns
from pinav.trajectories import Trajectories

FORMATS: tuple[AbstractFormat, ...] = (
    IdTracker(),
    Geff(),
    Tidy(),
    TrackMateCSV(),
    TrackMateProject(),
    Icy(),
    TrackMateXML(),
    MagScope(),
    *DESCRIBED,
    Trackpy(),
    SFI(),
    MTrackJ(),
    Sleap(),
    DeepLabCut(),
    ImageJ(),
    TRex(),
    UTrack(),
    Matlab(),
    MappedTable(),
)
"""The formats, in the order in which a file is tried."""


def read_recording(
    path: str | os.PathLike[str] | DataFrame,
    *,
    format: str | None = None,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    fps: float | None = None,
    mpp: float | None = None,
    y_down: bool | None = None,
    heading_offset: float = 0.0,
    delay: float = 0.0,
    jump: float | None = None,
    gap: int = 10,
    likelihood: float = 0.6,
    runs: Sequence[str] = (),
    particles: Sequence[str] = (),
    sheet: str | None = None,
    skip: int | None = None,
    strict: bool = False,
    commands: str | os.PathLike[str] | None = None,
) -> Trajectories:
    r"""A recording as one trajectory for each run, particle and segment.

    Channels are x and y with y up, in um where the scale is known; times in s where
    the rate is known. Commands, where there are any, have the names of
    `pinav.recordings.COMMAND_UNITS`; the heading is the y-up azimuth of the commanded
    motion. At the sample time $t$ a command is the last one logged up to
    $t - \tau$ with the delay $\tau$ (zero-order hold). The provenance holds everything
    that was done, and `labels` tells which trajectory is which.

    Args:
        path: the file, gzip is unpacked; or a DataFrame.
        format: name of the format; found from the content unless given.
        columns: the file's name of each quantity, for tables of any make.
        units: unit of a quantity in such a table, where it is not the usual one.
        fps: frames per second [1/s]; times become frame / fps.
        mpp: scale of positions in pixels [um/px].
        y_down: whether y grows downwards in the file; what is usual for the format
            unless given.
        heading_offset: added to the logged heading [rad]; never guessed.
        delay: by which commands act late [s].
        jump: displacement from row to row that splits a track, in px or um as the
            file has it, before `mpp`; 40 px or 15 um unless given.
        gap: frames without the particle that split a track.
        likelihood: below which a position counts as lost, where the file has one.
        runs: names of the runs that are kept; all unless given.
        particles: names of the particles that are kept; all unless given.
        sheet: name of the sheet of a workbook.
        skip: rows above the header; titles are found by their widths unless given.
        strict: refuse a bad row; it is left out and counted unless given.
        commands: a log of commands of its own, by time or frame; `columns` names its
            columns too.

    Raises:
        InputError: the file cannot be read as a recording; the message names the file,
            the row and the column.
    """
    reading = Reading(
        columns=columns,
        units=units,
        fps=fps,
        mpp=mpp,
        y_down=y_down,
        heading_offset=heading_offset,
        delay=delay,
        jump=jump,
        gap=gap,
        likelihood=likelihood,
        runs=runs,
        particles=particles,
        layout=Layout(sheet, skip, strict),
    )
    name = "DataFrame" if isinstance(path, DataFrame) else os.fspath(path)
    try:
        source = (
            Source.of_frame(path, reading.layout)
            if isinstance(path, DataFrame)
            else Source.read(path, reading.layout)
        )
        tracked = reading if commands is None else _without_commands(reading)
        chosen = _format(format, source, tracked)
        recording = assemble(
            chosen.tracks(source, tracked), tracked, source, chosen.name
        )
        if commands is None:
            return recording
        log = read_log(Source.read(commands, Layout(None, None, strict)), reading)
        return with_commands(recording, log, reading)
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    except ModuleNotFoundError as error:
        raise InputError(
            f"{name}: this format needs the package {error.name}; install "
            "pinav[recordings]"
        ) from error


def _format(name: str | None, source: Source, reading: Reading) -> AbstractFormat:
    """The format of that name, or the first that suits the content."""
    by_name = {format.name: format for format in FORMATS}
    if name is None and reading.columns and "variable" not in reading.columns:
        name = MappedTable.name
    if name is not None:
        if name not in by_name:
            raise InputError(
                f"format: expected one of {', '.join(by_name)}; got {name!r}"
            )
        return by_name[name]
    for format in FORMATS:
        if format.suits(source):
            return format
    names = source.column_names
    if source.kind == "workbook":
        names = list(source.table().columns)
    if not names:
        raise InputError(
            f"the format is not known ({_KINDS.get(source.kind, source.kind)}); give "
            f"its name as format, one of {', '.join(by_name)}, or export a table as CSV"
        )
    likely = likely_columns(names)
    if not {"x", "y"} & set(likely) and {"frequency", "heading"} & set(likely):
        raise InputError(
            f"columns {', '.join(names)}: a log of commands alone is no recording; "
            "give it as commands beside the file of the tracker"
        )
    raise InputError(
        f"the format is not known; say what its columns {', '.join(names)} are: start "
        f"from {example_of_columns(names)}, or give the name of its format, one of "
        f"{', '.join(by_name)}"
    )


_KINDS = {
    "old workbook": "a workbook of Excel before 2007: save it as .xlsx",
    "json": "JSON, whose layout nobody knows",
    "folder": "a folder without the files of a known one",
    "zip": "an archive without the arrays of a known tracker",
}


def _without_commands(reading: Reading) -> Reading:
    """How the tracker's file is read where the commands are in a log of their own."""
    columns = {
        name: column
        for name, column in (reading.columns or {}).items()
        if name not in COMMAND_UNITS
    }
    stated = {n: u for n, u in (reading.units or {}).items() if n not in COMMAND_UNITS}
    return dataclasses.replace(
        reading,
        columns=columns or None,
        units=stated or None,
        delay=0.0,
        heading_offset=0.0,
    )
