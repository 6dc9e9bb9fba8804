"""The options that say how a recording is read; imports no numerical library."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from pinav.commands.settings import (
    Settings,
)
from pinav.errors import InputError

if TYPE_CHECKING:
    from pinav.trajectories import Trajectories


class RecordingSettings(Settings, frozen=True):
    """What a file does not say of itself."""

    format: Annotated[
        str | None,
        tyro.conf.arg(help="Format of the file; found from its content by default."),
    ] = None
    columns: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            help="For any other table: quantity=column, such as x=X y=Y t=Time "
            "heading=alpha frequency=f."
        ),
    ] = ()
    units: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            help="Units that the file does not state, such as x=px t=ms heading=deg."
        ),
    ] = ()
    fps: Annotated[
        float | None,
        tyro.conf.arg(help="Frames per second; times become frame / fps."),
    ] = None
    mpp: Annotated[float | None, tyro.conf.arg(help="Micrometres per pixel.")] = None
    y: Annotated[
        Literal["down", "up"] | None,
        tyro.conf.arg(
            help="Whether y grows downwards in the file, as in images, or upwards; "
            "usual for the format by default."
        ),
    ] = None
    heading_offset: Annotated[
        float,
        tyro.conf.arg(
            help="Added to the logged heading, in rad: pi/2 = 1.5708 where the log "
            "holds the azimuth of the rotation axis."
        ),
    ] = 0.0
    delay: Annotated[
        float, tyro.conf.arg(help="By how many seconds commands act late.")
    ] = 0.0
    jump: Annotated[
        float | None,
        tyro.conf.arg(
            help="Displacement between rows that splits a track; 40 px or 15 um by "
            "default."
        ),
    ] = None
    gap: Annotated[
        int, tyro.conf.arg(help="Frames without the particle that split a track.")
    ] = 10
    likelihood: Annotated[
        float, tyro.conf.arg(help="Below it a position counts as lost (DeepLabCut).")
    ] = 0.6

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
        from pinav.recordings import read_recording

        return read_recording(
            path,
            format=self.format,
            columns=_pairs("columns", self.columns),
            units=self.stated_units(),
            fps=self.fps,
            mpp=self.mpp,
            y_down=None if self.y is None else self.y == "down",
            heading_offset=self.heading_offset,
            delay=self.delay,
            jump=self.jump,
            gap=self.gap,
            likelihood=self.likelihood,
        )


def _pairs(name: str, words: Sequence[str]) -> dict[str, str] | None:
    """Names and what they stand for, of words such as x=X."""
    pairs = [word.split("=", 1) for word in words]
    for word, pair in zip(words, pairs, strict=True):
        if len(pair) != 2 or not all(pair):
            raise InputError(f"--{name}: expected words such as x=X, got {word!r}")
    return dict(pairs) or None
