"""Options of `pinav inspect`; imports no numerical library."""

from pathlib import Path

import tyro

from pinav.commands.settings import Settings
from pinav.reading import PLAIN, Reading


class InspectOptions(Settings, frozen=True):
    """Say what a recording of a tracker holds and how good it is, before any fit.

    Runs, particles, segments, frame rate, gaps, localisation error, speed against
    frequency, coverage of the commands, and what a fit cannot tell. The format is
    found from the content: trackpy, TrackMate, MagScope, MATLAB, DeepLabCut, ImageJ,
    StochasticForceInference, tidy tables, any table by --columns; docs/recordings.md.

    Attributes:
        file: File of the tracker.
        out: Folder for inspection.json, inspection.html, a figure, and reading.toml,
            which other commands take as --reading.
        image: A still of the film (PNG, JPEG), to draw the paths over it.
        overwrite: Replace the report that --out already holds.
        json: Print the report as JSON, for scripts.
    """

    file: tyro.conf.Positional[Path]
    out: Path | None = None
    settings: Reading = PLAIN
    image: Path | None = None
    overwrite: bool = False
    json: bool = False
