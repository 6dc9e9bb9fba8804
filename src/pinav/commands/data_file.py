"""The data of a command: trajectories of pinav, or a recording of a tracker."""

import contextlib
import re
from pathlib import Path

from pinav.errors import InputError
from pinav.reading import PLAIN, Reading
from pinav.recordings import read_recording
from pinav.recordings.conventions import doubts
from pinav.trajectories import PREFIX, Trajectories, is_trajectories, load


def read_data(
    path: Path, reading: Reading = PLAIN, *, doubtful: bool = False
) -> Trajectories:
    """The trajectories in a file.

    Args:
        reading: how it is read where it is a recording.
        doubtful: a recording whose conventions look wrong is read all the same, as
            `pinav inspect` does.
    """
    try:
        return _read(path, reading, doubtful=doubtful)
    except InputError as error:
        if doubtful or not re.search("--[a-z]", str(error)):
            raise
        raise InputError(f"{error}; {ELSEWHERE}") from error


def _read(path: Path, reading: Reading, *, doubtful: bool) -> Trajectories:
    if reading.columns or reading.format or not is_trajectories(path):
        data = read_recording(path, reading)
        several = [] if doubtful else doubts(data)
        if several:
            raise InputError(f"{path}: {'; '.join(several)}")
        return data
    for name in reading.content():
        if name != "units":
            raise InputError(
                f"{name}: {path} holds trajectories of pinav, to which this setting "
                "of recordings does not apply; drop it"
            )
    try:
        return load(path, units=reading.units)
    except InputError as error:
        hint = _as_a_table(path)
        if not hint:
            raise
        raise InputError(f"{error}; or read it as a tracker's table: {hint}") from error


ELSEWHERE = (
    "such options are those of pinav inspect; other commands take --reading with the "
    "same words, such as --reading fps=10 units.heading=deg, or with the file that "
    "pinav inspect writes"
)
"""The words after a message that names options of `pinav inspect`."""


def _as_a_table(path: Path) -> str:
    """The option that reads a table as a recording; none for what pinav wrote."""
    if path.suffix.lower() != ".csv" or not path.is_file():
        return ""
    from pinav.recordings.source import Source
    from pinav.recordings.table import example_of_columns, likely_columns

    with contextlib.suppress(InputError):
        source = Source.read(path)
        names = source.column_names
        if not source.text.startswith(PREFIX) and {"x", "y"} <= set(
            likely_columns(names)
        ):
            return example_of_columns(names)
    return ""
