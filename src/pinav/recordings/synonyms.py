"""Names that laboratories give the columns of a table, by what they mean."""

import re
from collections.abc import Mapping, Sequence

from pinav.recordings import units

SYNONYMS: Mapping[str, tuple[str, ...]] = {
    "t": ("t", "t s", "time", "times", "timestamp", "time stamp", "seconds", "zeit"),
    "frame": ("frame", "frames", "slice", "image", "frame number", "imagenumber"),
    "x": ("x", "x um", "x px", "pos x", "posx", "xpos", "position x", "x position"),
    "y": ("y", "y um", "y px", "pos y", "posy", "ypos", "position y", "y position"),
    "z": ("z", "z um", "pos z", "posz", "zpos", "position z", "z position"),
    "particle": (
        *("particle", "id", "track", "track id", "trackid", "trajectory", "tid"),
        *("robot", "bot"),
    ),
    "run": ("run", "experiment", "movie", "video"),
    "frequency": ("frequency", "freq", "freq hz", "f", "rolling frequency", "drive"),
    "heading": ("heading", "alpha", "alpha rad", "angle", "angle rad", "azimuth"),
    "gamma": ("gamma", "gamma rad"),
    "psi": ("psi", "psi rad"),
    "field_x": ("field x", "bx"),
    "field_y": ("field y", "by"),
    "field_z": ("field z", "bz"),
    "acoustic_frequency": ("acoustic frequency", "acoustic hz"),
}
"""Names in small letters, without units, words parted by spaces."""


def likely_columns(names: Sequence[str]) -> dict[str, str]:
    """The column that each quantity probably has; none where no name says so.

    Args:
        names: of the columns of a table.
    """
    likely = {}
    for quantity, words in SYNONYMS.items():
        short = {name: _without_qualifiers(name, quantity) for name in names}
        match = [name for word in words for name in names if short[name] == word]
        if match:
            likely[quantity] = match[0]
    return likely


_OF_COMMANDS = (
    r"field(?! [xyz]\b)|magnetic|coil|command|commanded|set|rotation|rotating"
)
_OF_POSITIONS = "centroid|wcentroid|center|centre|mean|spot|particle|robot"
_POSITIONS = ("x", "y", "z", "particle")


def _without_qualifiers(name: str, quantity: str) -> str:
    """A name without the words that do not change what a quantity is."""
    plain = _plain(name)
    if any(plain in words for words in SYNONYMS.values()):
        return plain
    words = _OF_POSITIONS if quantity in _POSITIONS else _OF_COMMANDS
    return re.sub(rf" *\b({words})\b *", " ", plain).strip()


def _plain(name: str) -> str:
    return re.sub(r"[\s_.#\-]+", " ", units.split_heading(name)[0]).strip().lower()


def example_of_columns(names: Sequence[str]) -> str:
    """The option `--columns` to start from.

    Args:
        names: of the columns of a table.
    """
    likely = likely_columns(names)
    if "t" in likely:
        likely.pop("frame", None)
    wanted = ["t" if "frame" not in likely else "frame", "x", "y"]
    rest = [name for name in names if name and name not in likely.values()]
    for quantity in wanted:
        if quantity not in likely:
            likely[quantity] = rest.pop(0) if rest else "?"
    order = [*wanted, *(q for q in likely if q not in wanted)]
    words = [f"{q}={likely[q]}" for q in order]
    return "--columns " + " ".join(f"'{w}'" if " " in w else w for w in words)
