"""The options that say how a recording is read; imports no numerical library."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from pinav.commands.settings import Range, Settings
from pinav.errors import InputError

if TYPE_CHECKING:
    from pinav.trajectories import Trajectories


class RecordingSettings(Settings, frozen=True):
    """What a file does not say of itself.

    Attributes:
        format: Format of the file; found from its content by default.
        columns: For any other table: quantity=column, such as x=X y=Y t=Time
            heading=alpha frequency=f; x=x* y=y* where each particle has columns of its
            own, dt where a column holds the interval of each frame.
        units: Units that the file does not state, such as x=px t=ms heading=deg.
        fps: Frames per second; times become frame / fps.
        mpp: Micrometres per pixel.
        y: Whether y grows downwards in the file, as in images, or upwards; usual for
            the format by default.
        heading_offset: Added to the logged heading, in rad: pi/2 = 1.5708 where the log
            holds the azimuth of the rotation axis.
        delay: By how many seconds commands act late.
        jump: Displacement between rows that splits a track; 40 px or 15 um by default.
        gap: Frames without the particle that split a track.
        likelihood: Below it a position counts as lost (DeepLabCut, SLEAP, TRex).
        runs: Names of the runs that are kept.
        particles: Names of the particles that are kept.
        sheet: Name of the sheet of a workbook.
        skip: Rows above the header; titles are found by themselves as a rule.
        strict: Refuse a bad row; by default it is left out and counted.
        commands: File of a log of commands, by time or frame, beside the tracker's.
    """

    format: str | None = None
    columns: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    fps: float | None = None
    mpp: float | None = None
    y: Literal["down", "up"] | None = None
    heading_offset: float = 0.0
    delay: float = 0.0
    jump: float | None = None
    gap: int = 10
    likelihood: float = 0.6
    runs: tuple[str, ...] = ()
    particles: tuple[str, ...] = ()
    sheet: str | None = None
    skip: Annotated[int, Range(0)] | None = None
    strict: bool = False
    commands: Path | None = None

    def stated_units(self) -> dict[str, str] | None:
        """Units by quantity, as the option gives them.

        Raises:
            InputError: a word is not of the form quantity=unit.
        """
        return _pairs("units", self.units)

    def read(self, path: Path) -> "Trajectories":
        """The recording in a file.

        Raises:
            InputError: a setting makes no sense, or the file is damaged.
        """
        from pinav.recordings import Reading, read_recording

        # The same names, but for those that a command line writes as words.
        words = ("columns", "units", "y")
        plain = (name for name in self.__struct_fields__ if name not in words)
        reading = Reading(
            **{name: getattr(self, name) for name in plain},
            columns=_pairs("columns", self.columns),
            units=self.stated_units(),
            y_down=None if self.y is None else self.y == "down",
        )
        return read_recording(path, reading)


def _pairs(name: str, words: Sequence[str]) -> dict[str, str] | None:
    """Names and what they stand for, of words such as x=X."""
    pairs = [word.split("=", 1) for word in words]
    for word, pair in zip(words, pairs, strict=True):
        if len(pair) != 2 or not all(pair):
            raise InputError(f"--{name}: expected words such as x=X, got {word!r}")
    return dict(pairs) or None
