"""Options of `pinav inspect`; imports no numerical library."""

from pathlib import Path
from typing import Annotated

import tyro

from pinav.commands.recording_settings import RecordingSettings
from pinav.commands.settings import Settings


class InspectOptions(Settings, frozen=True):
    """Say what a recording of a tracker holds and how good it is, before any fit.

    Runs, particles, segments, frame rate, gaps, localisation error, speed against
    frequency, coverage of the commands, and what a fit cannot tell. The format is
    found from the content: trackpy, TrackMate, MagScope, MATLAB, DeepLabCut, ImageJ,
    StochasticForceInference, tidy tables, any table by --columns; docs/recordings.md.
    """

    file: Annotated[
        Path, tyro.conf.Positional, tyro.conf.arg(help="File of the tracker.")
    ]
    out: Annotated[
        Path | None,
        tyro.conf.arg(help="Folder for inspection.json, inspection.html and a figure."),
    ] = None
    settings: RecordingSettings = RecordingSettings()
    image: Annotated[
        Path | None,
        tyro.conf.arg(
            help="A still of the film (PNG, JPEG), to draw the paths over it."
        ),
    ] = None
    overwrite: Annotated[
        bool, tyro.conf.arg(help="Replace the report that --out already holds.")
    ] = False
    json: Annotated[
        bool, tyro.conf.arg(help="Print the report as JSON, for scripts.")
    ] = False
