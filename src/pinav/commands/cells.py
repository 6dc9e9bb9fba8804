"""Numbers as cells of tables and of JSON files."""

from typing import Any

import numpy as np


def as_cell(value: float | int) -> Any:
    """A number for JSON and tables: NaN is None, infinity the word "diverged"."""
    if isinstance(value, int):
        return value
    if np.isnan(value):
        return None
    return "diverged" if np.isinf(value) else float(value)
