"""Units that files are written in, and those that recordings are read into."""

from collections.abc import Callable, Mapping, Sequence

from pinav.errors import InputError

_MICROMETRES: Mapping[str, float] = {
    **dict.fromkeys(("um", "µm", "μm", "micron", "microns", "micrometer"), 1.0),
    "nm": 1e-3,
    "mm": 1e3,
    "cm": 1e4,
    "m": 1e6,
}
_SECONDS: Mapping[str, float] = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec"), 1e-3),
    "min": 60.0,
    "h": 3600.0,
}
_PIXELS = ("px", "pixel", "pixels")
_FRAMES = ("frame", "frames")
_COMMANDS: Mapping[str, Mapping[str, float]] = {
    "Hz": {"Hz": 1.0, "kHz": 1e3, "rpm": 1 / 60, "rad/s": 0.15915494309189535},
    "rad": {"rad": 1.0, "deg": 0.017453292519943295, "°": 0.017453292519943295},
    "1": {"1": 1.0, "%": 0.01},
}


def bare(unit: str | None) -> str:
    """A unit without its brackets, such as `um` of `(um)` and of `[um]`."""
    return (unit or "").strip().strip("()[]").strip()


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


def command(name: str, target: str, unit: str) -> float:
    """Factor that brings a command to the unit `target`.

    Raises:
        InputError: the unit does not measure such a quantity.
    """
    known = _COMMANDS.get(target, {})
    word = bare(unit)
    if word not in known:
        raise InputError(
            f"units: expected {name} in one of {', '.join(known)}; got {unit!r}"
        )
    return known[word]


def stated_length(units: Mapping[str, str] | None) -> tuple[float, str] | None:
    """Factor and unit of positions as the user states them, if at all.

    Raises:
        InputError: the unit is none of length.
    """
    return _stated(units, "x", length, (*_MICROMETRES, "px"))


def stated_duration(units: Mapping[str, str] | None) -> tuple[float, str] | None:
    """Factor and unit of times as the user states them, if at all.

    Raises:
        InputError: the unit is none of time.
    """
    return _stated(units, "t", duration, (*_SECONDS, "frame"))


def _stated(
    units: Mapping[str, str] | None,
    name: str,
    read: Callable[[str], tuple[float, str]],
    known: Sequence[str],
) -> tuple[float, str] | None:
    if units is None or name not in units:
        return None
    factor, unit = read(units[name])
    if unit == "?":
        raise InputError(
            f"units: expected {name} in one of {', '.join(known)}; got {units[name]!r}"
        )
    return factor, unit
