"""Settings of the ladder of `pinav fit RECORDING`; imports no numerical library."""

from typing import Annotated

import msgspec
import tyro

from pinav.errors import InputError


class LadderSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How a recording is split, and how much is fitted."""

    share: Annotated[
        float,
        tyro.conf.arg(help="Recording: first share of each track's time that trains."),
    ] = 0.7
    tracks: Annotated[
        int,
        tyro.conf.arg(
            help="Recording: at most so many tracks, the longest ones, get residuals "
            "and all baselines; all get the other rungs."
        ),
    ] = 9

    def check(self) -> None:
        """Raise `InputError` where a setting makes no sense."""
        if not 0 < self.share < 1:
            raise InputError(f"--share: expected between 0 and 1, got {self.share}")
        if self.tracks < 0:
            raise InputError(f"--tracks: expected 0 or more, got {self.tracks}")
