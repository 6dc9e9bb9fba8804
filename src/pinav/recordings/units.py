"""Units that files are written in, and those that recordings are read into."""

import re
from collections.abc import Mapping

from pinav.errors import InputError

_MICROMETRES: Mapping[str, float] = {
    **dict.fromkeys(("um", "µm", "μm", "micron", "microns"), 1.0),
    **dict.fromkeys(("micrometer", "micrometre", "micrometers", "micrometres"), 1.0),
    **dict.fromkeys(("nm", "nanometer", "nanometre"), 1e-3),
    **dict.fromkeys(("mm", "millimeter", "millimetre"), 1e3),
    **dict.fromkeys(("cm", "centimeter", "centimetre"), 1e4),
    "m": 1e6,
}
_SECONDS: Mapping[str, float] = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("min", "minute", "minutes"), 60.0),
    **dict.fromkeys(("h", "hour", "hours"), 3600.0),
    **dict.fromkeys(("d", "day", "days"), 86_400.0),
}
_PIXELS = ("px", "pixel", "pixels")
_FRAMES = ("frame", "frames")
_DEGREE = 0.017453292519943295
_COMMANDS: Mapping[str, Mapping[str, float]] = {
    "Hz": {
        **dict.fromkeys(("Hz", "hz", "1/s", "s^-1", "rev/s"), 1.0),
        "kHz": 1e3,
        "rpm": 1 / 60,
        "rad/s": 0.15915494309189535,
    },
    "rad": {
        **dict.fromkeys(("rad", "radian", "radians"), 1.0),
        **dict.fromkeys(("deg", "°", "degree", "degrees"), _DEGREE),
    },
    "1": {"1": 1.0, "%": 0.01},
}
_STATED = re.compile(
    r"(?P<name>.*?)\s*(?:\[(?P<a>[^\]]*)\]|\((?P<b>[^)]*)\)|/\s*(?P<c>\S+))\s*"
)


_BEHIND_UNDERSCORE = {
    *("um", "µm", "μm", "nm", "mm", "cm", "px", "pixel", "pixels"),
    *("s", "sec", "ms", "deg", "rad", "Hz", "hz", "kHz", "rpm"),
}
"""Units that are read there; a single letter could be anything, but for seconds."""


def bare(unit: str | None) -> str:
    """A unit without its brackets, such as `um` of `(um)` and of `[um]`."""
    return (unit or "").strip().strip("()[]").strip()


def is_unit(word: str) -> bool:
    """True for a known unit, with or without brackets."""
    word = bare(word)
    if not word:
        return False
    known = {
        *_MICROMETRES,
        *_SECONDS,
        *_FRAMES,
        *(u for c in _COMMANDS.values() for u in c),
    }
    return word in known or word.lower() in _PIXELS


def split_heading(heading: str) -> tuple[str, str]:
    """Name and unit of the heading of a column, such as `x [um]`, `x (µm)` or `t/ms`.

    What stands in brackets, behind a stroke or, as in `x_um`, behind the last
    underscore is no unit unless it is known as one; the name is then the whole heading.
    """
    match = _STATED.fullmatch(heading.strip())
    if match is None:
        name, _, unit = heading.strip().rpartition("_")
        sure = name and unit in _BEHIND_UNDERSCORE
        return (name, unit) if sure else (heading.strip(), "")
    unit = match["a"] or match["b"] or match["c"] or ""
    if not is_unit(unit) or not match["name"]:
        return heading.strip(), ""
    return match["name"], unit.strip()


def length(unit: str | None) -> tuple[float, str]:
    """Factor to um or px and that unit; "?" where the unit is unknown."""
    word = bare(unit)
    if word.lower() in _PIXELS:
        return 1.0, "px"
    return (_MICROMETRES[word], "um") if word in _MICROMETRES else (1.0, "?")


def duration(unit: str | None) -> tuple[float, str]:
    """Factor to s and that unit; "frame" for frames, "?" where it is unknown."""
    word = bare(unit)
    if word.lower() in _FRAMES:
        return 1.0, "frame"
    return (_SECONDS[word], "s") if word in _SECONDS else (1.0, "?")


def interval(where: str, word: str) -> float:
    """A time from frame to frame, which is a positive number."""
    try:
        value = float(word)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise InputError(
            f"{where}: expected a number > 0, got {word!r}; correct it, or export again"
        )
    return value


def command(name: str, target: str, unit: str) -> float:
    """Factor that brings a command to the unit `target`."""
    known = _COMMANDS.get(target, {})
    word = bare(unit)
    if word not in known:
        raise InputError(
            f"units: expected {name} in one of {', '.join(known)}; got {unit!r}"
        )
    return known[word]


def stated(units: Mapping[str, str] | None, name: str) -> tuple[float, str] | None:
    """Factor and unit that the user states of positions (x) or times (t), if any."""
    if units is None or name not in units:
        return None
    factor, unit = (length if name == "x" else duration)(units[name])
    if unit == "?":
        known = (*_MICROMETRES, "px") if name == "x" else (*_SECONDS, "frame")
        raise InputError(
            f"units: expected {name} in one of {', '.join(known)}; got {units[name]!r}"
        )
    return factor, unit
