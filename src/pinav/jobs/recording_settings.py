"""Settings of `pinav fit RECORDING`: strict, readable as TOML; no numerical library."""

from typing import Annotated

import msgspec
import tyro

from pinav.errors import InputError


class RecordingSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How a tracker's file is read and split."""

    form: Annotated[
        str | None,
        tyro.conf.arg(help="Format of the recording; detected unless given."),
    ] = None
    fps: Annotated[
        float | None,
        tyro.conf.arg(help="Recording: frames per second, where frames are the time."),
    ] = None
    mpp: Annotated[
        float | None,
        tyro.conf.arg(help="Recording: micrometres per pixel, where x, y are pixels."),
    ] = None
    heading_offset: Annotated[
        float,
        tyro.conf.arg(
            help="Recording: added to the commanded angle to get the heading [rad]; "
            "1.5708 where the angle is that of the rotation axis."
        ),
    ] = 0.0
    share: Annotated[
        float,
        tyro.conf.arg(help="Recording: first share of each track's time that trains."),
    ] = 0.7
    tracks: Annotated[
        int,
        tyro.conf.arg(
            help="Recording: at most so many tracks get residuals and baselines, the "
            "longest ones; all get the other rungs."
        ),
    ] = 9

    def check(self) -> None:
        """Raise `InputError` where a setting makes no sense."""
        if not 0 < self.share < 1:
            raise InputError(f"--share: expected between 0 and 1, got {self.share}")
        if self.tracks < 0:
            raise InputError(f"--tracks: expected 0 or more, got {self.tracks}")
        for name in ("fps", "mpp"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise InputError(f"--{name}: expected > 0, got {value}")
