"""Where the run of a case begins."""

import zipfile
import zlib
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from pinav.commands.heat.case import Before
from pinav.errors import InputError
from pinav.thermal.starts import AT_REST, AbstractStart, AtSteadyState, State

COLDEST, HOTTEST = -50.0, 150.0
"""Temperatures [°C] that tissue may begin with; beyond them they are kelvins."""


def build_start(
    start: Before | str, shape: tuple[int, ...], folder: Path
) -> AbstractStart:
    """The start that a case names.

    Args:
        start: what the case says.
        shape: of the grid.
        folder: in which a file is that the case names.

    Raises:
        InputError: the file cannot be read, or is of another grid.
    """
    if isinstance(start, Before):
        return _read_state(folder / start.file, shape)
    return AtSteadyState() if start == "steady" else AT_REST


def _read_state(path: Path, shape: tuple[int, ...]) -> State:
    arrays = _read_arrays(path)
    for name, values in arrays.items():
        if values.dtype.kind not in "biuf":
            raise InputError(
                f"{path}: expected numbers as {name}, got {values.dtype}; save floats"
            )
    if "temperature" not in arrays:
        raise InputError(
            f"{path}: expected the results.npz of a run, with a temperature, got "
            f"{', '.join(arrays) or 'nothing'}"
        )
    temperature = arrays["temperature"]
    dose = arrays.get("dose", np.zeros(shape))
    if temperature.shape != shape or dose.shape != shape:
        raise InputError(
            f"{path}: expected temperatures of shape {shape}, that of the grid, got "
            f"{temperature.shape}; take the same grid"
        )
    outside = ~((temperature >= COLDEST) & (temperature <= HOTTEST))
    if outside.any():
        raise InputError(
            f"{path}: expected temperatures between {COLDEST:g} and {HOTTEST:g} °C, "
            f"got {temperature[outside][0]:g}; subtract 273.15 from kelvins"
        )
    if not np.all((dose >= 0) & np.isfinite(dose)):
        raise InputError(
            f"{path}: expected doses >= 0 CEM43 min, got "
            f"{dose[~((dose >= 0) & np.isfinite(dose))][0]:g}; take results of a run"
        )
    return State(
        jnp.asarray(0.0), jnp.asarray(temperature, float), jnp.asarray(dose, float)
    )


def _read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Arrays of an npz file by their names, or of an npy file as temperatures."""
    try:
        with open(path, "rb") as file:
            content = np.load(file, allow_pickle=False)
            if isinstance(content, np.ndarray):
                return {"temperature": content}
            with content:
                names = [n for n in ("temperature", "dose") if n in content]
                return {name: content[name] for name in names}
    except (
        OSError,
        ValueError,
        EOFError,
        MemoryError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
