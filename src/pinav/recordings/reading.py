"""`read_recording`: a tracker's file, whatever its format, as `Trajectories`."""

import os

import msgspec

from pinav.errors import InputError
from pinav.reading import PLAIN, Reading
from pinav.recordings.assembly import assemble
from pinav.recordings.command_log import read_log, with_commands
from pinav.recordings.formats import trackmate
from pinav.recordings.formats.arrays import IdTracker, TRex
from pinav.recordings.formats.column_map import MappedTable
from pinav.recordings.formats.geff import Geff
from pinav.recordings.formats.magscope import MagScope
from pinav.recordings.formats.matlab import Matlab, UTrack
from pinav.recordings.formats.poses import DeepLabCut, Sleap
from pinav.recordings.formats.tables import DESCRIBED, IMAGEJ, SFI, MTrackJ, Tidy
from pinav.recordings.rows import COMMAND_UNITS
from pinav.recordings.source import AbstractFormat, DataFrame, Source
from pinav.recordings.table import example_of_columns, likely_columns
from pinav.trajectories import Trajectories

FORMATS: tuple[AbstractFormat, ...] = (
    IdTracker(),
    Geff(),
    Tidy(),
    trackmate.TrackMateCSV(),
    trackmate.TrackMateProject(),
    trackmate.Icy(),
    trackmate.TrackMateXML(),
    MagScope(),
    *DESCRIBED,
    SFI(),
    MTrackJ(),
    Sleap(),
    DeepLabCut(),
    IMAGEJ,
    TRex(),
    UTrack(),
    Matlab(),
    MappedTable(),
)
"""The formats, in the order in which a file is tried."""


def read_recording(
    path: str | os.PathLike[str] | DataFrame, reading: Reading = PLAIN
) -> Trajectories:
    r"""A recording as one trajectory for each run, particle and segment.

    Channels are x and y with y up, in um where the scale is known; times in s where the
    rate is known. Commands have the names of `pinav.recordings.COMMAND_UNITS`; the
    heading is the y-up azimuth of the commanded motion. The command at a time $t$ is
    the last one logged up to $t - \tau$ with the delay $\tau$ (zero-order hold). The
    provenance records every step, and `labels` names the trajectories. Gzip is
    unpacked.

    Args:
        reading: what the file does not state.

    Raises:
        InputError: the file cannot be read as a recording; the message names the file,
            the row and the column.
    """
    name = "DataFrame" if isinstance(path, DataFrame) else os.fspath(path)
    commands = reading.commands
    tracked = reading if commands is None else _without_commands(reading)
    try:
        source = Source.read(path, tracked)
        chosen = _format(source)
        recording = assemble(chosen.tracks(source), source, chosen.name)
        if commands is None:
            return recording
        log = Source.read(commands, Reading(strict=reading.strict))
        return with_commands(recording, read_log(log, reading), reading)
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    except ModuleNotFoundError as error:
        raise InputError(
            f"{name}: this format needs the package {error.name}; install "
            "pinav[recordings]"
        ) from error


def _format(source: Source) -> AbstractFormat:
    reading = source.reading
    name = reading.format
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
    """The reading of a tracker's file whose commands have their own log."""
    columns = {
        name: column
        for name, column in (reading.columns or {}).items()
        if name not in COMMAND_UNITS
    }
    stated = {n: u for n, u in (reading.units or {}).items() if n not in COMMAND_UNITS}
    return msgspec.structs.replace(
        reading,
        columns=columns or None,
        units=stated or None,
        delay=0.0,
        heading_offset=0.0,
    )
