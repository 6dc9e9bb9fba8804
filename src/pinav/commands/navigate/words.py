"""Words for intervals and for numbers that may not exist."""

import math

from pinav.navigation import Interval


def percent_interval(interval: Interval) -> str:
    """The interval of a proportion."""
    parts = interval.value, interval.lower, interval.upper
    value, lower, upper = (100 * part for part in parts)
    return f"{value:.0f} % ({lower:.0f}–{upper:.0f})"


def ratio_interval(interval: Interval) -> str:
    """The interval of a ratio."""
    parts = interval.value, interval.lower, interval.upper
    value, lower, upper = ("∞" if math.isinf(p) else f"{p:.3f}" for p in parts)
    return f"{value} ({lower}–{upper})"


def known(value: float) -> float | None:
    """A number, or none where nobody arrived."""
    return None if math.isnan(value) else value
