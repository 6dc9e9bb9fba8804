"""Settings of `pinav identify`; imports no numerical library."""

from typing import Annotated, Literal

from pinav.commands.settings import FilesOptions, Range, ReadingWords, Settings
from pinav.reading import PLAIN


class IdentifySettings(Settings, frozen=True):
    """Split of a recording, and the models that are fitted.

    Attributes:
        train_fraction: First part of each track's time that trains.
        candidates: responses: first-order models from drift to a delayed, slipping
            propulsion; all: also fields of position.
        max_tracks: With --candidates all: at most so many tracks, the longest ones, get
            all of them.
        track: Name of the track whose system the run holds; the longest one that was
            driven by default.
    """

    train_fraction: Annotated[float, Range(above=0, below=1)] = 0.7
    candidates: Literal["responses", "all"] = "responses"
    max_tracks: Annotated[int, Range(0)] = 9
    track: str | None = None


class IdentifyOptions(FilesOptions, frozen=True, kw_only=True):
    """Find which response to its commands a recorded swimmer shows.

    First-order models from drift to a delayed, slipping propulsion are fitted to the
    first part of each track of a recording and rolled out on the rest; the evidence
    chooses. RUN/system.toml is the swimmer that it finds, for pinav fit --system.
    """

    settings: IdentifySettings = IdentifySettings()
    reading: ReadingWords = PLAIN
