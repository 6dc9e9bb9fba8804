"""Numbers of results as JSON and tables hold them."""

import math

Cell = float | int | str | None
"""A score: None where it is not defined, "diverged" where it is infinite."""


def as_cell(value: float | int) -> Cell:
    """A number for JSON and tables: NaN is None, infinity the word "diverged"."""
    if isinstance(value, int):
        return value
    if math.isnan(value):
        return None
    return "diverged" if math.isinf(value) else float(value)
