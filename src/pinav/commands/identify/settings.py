"""Settings of `pinav identify`; imports no numerical library."""

from pathlib import Path
from typing import Annotated

import tyro

from pinav.commands.recording_settings import RecordingSettings
from pinav.commands.settings import (
    AsJson,
    ConfigFile,
    OutFolder,
    Overwrite,
    Resume,
    Settings,
)
from pinav.errors import InputError


class IdentifySettings(Settings, frozen=True):
    """How a recording is split, and how much is fitted."""

    share: Annotated[
        float,
        tyro.conf.arg(help="Recording: first share of each track's time that trains."),
    ] = 0.7
    tracks: Annotated[
        int,
        tyro.conf.arg(
            help="Recording: at most so many tracks, the longest ones, get residuals "
            "and all baselines; all get the other candidates."
        ),
    ] = 9

    def check(self) -> None:
        """Raise `InputError` where a setting makes no sense."""
        if not 0 < self.share < 1:
            raise InputError(f"--share: expected between 0 and 1, got {self.share}")
        if self.tracks < 0:
            raise InputError(f"--tracks: expected 0 or more, got {self.tracks}")


class IdentifyOptions(Settings, frozen=True):
    """Find which response to its commands a recorded swimmer shows.

    First-order models from drift to a delayed, slipping propulsion are fitted to the
    first part of each track of a recording and rolled out on the rest; the evidence
    chooses. With --baselines also position-dependent residuals and other methods.
    """

    data: Annotated[
        Path,
        tyro.conf.Positional,
        tyro.conf.arg(help="Recording: a file of a tracker, or of pinav."),
    ]
    out: OutFolder
    baselines: Annotated[
        bool,
        tyro.conf.arg(help="Fit position-dependent residuals and baselines too."),
    ] = False
    settings: IdentifySettings = IdentifySettings()
    recording: RecordingSettings = RecordingSettings()
    config: ConfigFile = None
    resume: Resume = False
    overwrite: Overwrite = False
    json: AsJson = False
