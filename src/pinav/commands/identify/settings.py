"""Settings of `pinav identify`; imports no numerical library."""

from pathlib import Path
from typing import Annotated, Literal

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

    train_fraction: Annotated[
        float,
        tyro.conf.arg(help="First part of each track's time that trains."),
    ] = 0.7
    candidates: Annotated[
        Literal["responses", "all"],
        tyro.conf.arg(
            help="responses: first-order models from drift to a delayed, slipping "
            "propulsion; all: also fields of position, and other methods for "
            "comparison."
        ),
    ] = "responses"
    max_tracks: Annotated[
        int,
        tyro.conf.arg(
            help="With --candidates all: at most so many tracks, the longest ones, get "
            "all of them."
        ),
    ] = 9
    track: Annotated[
        str | None,
        tyro.conf.arg(
            help="Name of the track whose system the run holds; the longest one that "
            "was driven by default."
        ),
    ] = None

    def check(self) -> None:
        """Raise `InputError` where a setting makes no sense."""
        if not 0 < self.train_fraction < 1:
            raise InputError(
                f"--train-fraction: expected between 0 and 1, got {self.train_fraction}"
            )
        if self.max_tracks < 0:
            raise InputError(f"--max-tracks: expected 0 or more, got {self.max_tracks}")


class IdentifyOptions(Settings, frozen=True):
    """Find which response to its commands a recorded swimmer shows.

    First-order models from drift to a delayed, slipping propulsion are fitted to the
    first part of each track of a recording and rolled out on the rest; the evidence
    chooses. RUN/system.toml is the swimmer that it finds, for pinav fit --system.
    """

    data: Annotated[
        Path,
        tyro.conf.Positional,
        tyro.conf.arg(help="Recording: a file of a tracker, or of pinav."),
    ]
    out: OutFolder
    settings: IdentifySettings = IdentifySettings()
    recording: RecordingSettings = RecordingSettings()
    config: ConfigFile = None
    resume: Resume = False
    overwrite: Overwrite = False
    json: AsJson = False
