"""A recording's conventions that its file does not state, as options or a TOML file.

This module imports no numerical library, so that `--help` is quick.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec

from pinav.errors import InputError
from pinav.files import read_toml
from pinav.settings import NOT_NEGATIVE, POSITIVE, Range, Settings

Content = dict[str, Any]
"""Settings as TOML holds them."""

Pairs = dict[str, str]
"""Names and what they stand for."""


class Reading(Settings, frozen=True):
    """How a recording is read: what its file does not say of itself.

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

    Raises:
        InputError: a number is not positive, or `delay` is negative.
    """

    format: str | None = None
    columns: Pairs | None = None
    units: Pairs | None = None
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
    skip: int | None = None
    strict: bool = False
    commands: Path | None = None

    def __post_init__(self) -> None:
        for name in ("fps", "mpp", "jump", "gap"):
            POSITIVE.check(name, getattr(self, name))
        for name in ("delay", "skip"):
            NOT_NEGATIVE.check(name, getattr(self, name))
        Range(least=0, most=1).check("likelihood", self.likelihood)
        if not math.isfinite(self.heading_offset):
            raise InputError(
                f"heading_offset: expected a number of radians, "
                f"got {self.heading_offset}"
            )

    @classmethod
    def of_words(cls, words: Sequence[str]) -> "Reading":
        """What words state, such as fps=10 units.heading=rad runs=a,b or a TOML file.

        A later word stands above an earlier one.

        Raises:
            InputError: a file cannot be read, or a word states nothing that there is.
        """
        content: Content = {}
        for word in words:
            key, sign, value = word.partition("=")
            if not sign:
                content |= _of_file(Path(word))
            elif not value:
                raise InputError(f"expected a value after {word!r}")
            elif key.startswith(("columns.", "units.")):
                group, _, name = key.partition(".")
                content[group] = content.get(group, {}) | {name: value}
            else:
                several = key in ("runs", "particles")
                content[key] = value.split(",") if several else value
        return cls.of_content(content)

    @classmethod
    def of_content(cls, content: Content) -> "Reading":
        """What the table of a TOML file states, or words do.

        Raises:
            InputError: a name is unknown, or a value makes no sense.
        """
        try:
            return msgspec.convert(
                content, cls, strict=False, dec_hook=lambda kind, value: kind(value)
            )
        except msgspec.ValidationError as error:
            raise InputError(
                f"reading: {error}; expected words such as fps=10 mpp=0.5 y=up "
                "units.heading=rad columns.x=X runs=a,b, or a file of them"
            ) from error

    def content(self) -> Content:
        """What differs from the default, as TOML holds it."""
        plain = msgspec.to_builtins(PLAIN, enc_hook=str)
        stated = msgspec.to_builtins(self, enc_hook=str)
        return {k: v for k, v in stated.items() if v not in (plain[k], None)}


def _of_file(path: Path) -> Content:
    """What a file states; the log of commands that it names lies beside it."""
    expected = "expected NAME=VALUE, or a TOML file that pinav inspect wrote"
    content = read_toml(path, f"--reading {path}: {expected}")
    if isinstance(log := content.get("commands"), str):
        content["commands"] = str(path.parent / log)
    return content


PLAIN = Reading()
"""A file that says everything of itself."""
