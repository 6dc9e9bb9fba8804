"""Tables of ImageJ: Results, and the Manual Tracking plugin."""

from typing import final

from pinav.errors import InputError
from pinav.recordings.formats.format import AbstractFormat
from pinav.recordings.rows import Reading, Tracks
from pinav.recordings.source import Source


@final
class ImageJ(AbstractFormat):
    """`X, Y` or `XM, YM` with a `Slice` (Results); `Track n°, Slice n°, X, Y`.

    The table does not say whether it is calibrated: state `units={"x": "px"}` or give
    `mpp`. Results without a column `Track` are of one particle. y is down.
    """

    name = "imagej"

    def suits(self, source: Source) -> bool:
        names = source.column_names
        return bool(_slice(names)) and bool(_positions(names))

    def tracks(self, source: Source, reading: Reading) -> Tracks:
        table = source.table()
        names = list(table.columns)
        frame, track = _slice(names), _starting(names, ("Track", "Particle"))
        positions = _positions(names)
        if not frame or not positions:
            raise InputError(
                f"{table.header}: expected columns X, Y (or XM, YM) and Slice, got "
                f"{', '.join(names)}; tick centroid and stack position in Set "
                "Measurements"
            )
        by_hand = frame.startswith("Slice n")
        return Tracks(
            x=table.numbers(positions[0], lost=True),
            y=table.numbers(positions[1], lost=True),
            place=table.row,
            particle=table.labels(track) if track else None,
            frame=table.whole_numbers(frame, least=0),
            length_unit="px" if by_hand else "?",
            columns={"frame": frame},
        )


def _slice(names: list[str]) -> str:
    return _starting(names, ("Slice", "Frame"))


def _starting(names: list[str], words: tuple[str, ...]) -> str:
    """The first column that is such a word or, as in `Slice n°`, begins with it."""
    for word in words:
        for name in names:
            if name == word or name.startswith(f"{word} n"):
                return name
    return ""


def _positions(names: list[str]) -> tuple[str, str] | None:
    for pair in (("X", "Y"), ("XM", "YM")):
        if set(pair) <= set(names):
            return pair
    return None
