"""A `RunningFit` as arrays with names, and back, to the last bit."""

import dataclasses

import numpy as np

from pinav.identification.running.bank import Bank
from pinav.identification.running.commands import CommandHistory
from pinav.identification.running.frames import Frames
from pinav.identification.running.grid import DriveGrid
from pinav.identification.running.running_fit import RunningFit

PARTS = {"bank": Bank, "history": CommandHistory, "frames": Frames}
"""Fields that hold arrays of their own."""

Arrays = dict[str, np.ndarray]


def to_arrays(fit: RunningFit) -> Arrays:
    """Everything but the grid; what is absent has no array."""
    arrays: Arrays = {}
    for field in dataclasses.fields(fit):
        value = getattr(fit, field.name)
        if field.name in PARTS and value is not None:
            for part in dataclasses.fields(value):
                content = getattr(value, part.name)
                arrays[f"{field.name}.{part.name}"] = np.asarray(content)
        elif field.name != "grid" and value is not None:
            arrays[field.name] = np.asarray(value)
    return arrays


def fit_of(grid: DriveGrid, arrays: Arrays) -> RunningFit:
    """The fit with this grid that has written these arrays.

    Args:
        grid: that of the fit.
        arrays: may hold others too.
    """
    values = {}
    for field in dataclasses.fields(RunningFit):
        if field.name in PARTS:
            prefix = f"{field.name}."
            parts = {
                name.removeprefix(prefix): _plain(array)
                for name, array in arrays.items()
                if name.startswith(prefix)
            }
            values[field.name] = PARTS[field.name](**parts) if parts else None
        elif field.name in arrays:
            values[field.name] = _plain(arrays[field.name])
    return RunningFit(grid, **values)


def _plain(array: np.ndarray) -> np.ndarray | float:
    """A number where the array has no axes."""
    return array if array.ndim else float(array)
