"""Readings that a case names: of probes in a CSV file, or of voxels in an image."""

from pathlib import Path

import numpy as np

from pinav.errors import InputError
from pinav.thermal.case_geometry import Frames, Learn
from pinav.thermal.images import NEGLIGIBLE, Image, check_place, read_image
from pinav.thermal.probes import HOTTEST_READING, ProbeData, load_probes
from pinav.thermal.quantities import NOISIEST
from pinav.thermal.setup import Setup
from pinav.thermal.thermometry import Thermometry, phase_turn

Readings = ProbeData | Thermometry


def read_data(settings: Learn, setup: Setup, folder: Path) -> Readings | None:
    """The readings of a case; none where it makes its own.

    Raises:
        InputError: a file cannot be read, or holds what no thermometer says.
    """
    if settings.thermometry is not None:
        return _read_frames(settings.thermometry, setup, folder)
    return None if settings.data is None else load_probes(folder / settings.data)


def readings_until(data: Readings, time: float) -> Readings:
    """Those up to a time [s].

    Raises:
        InputError: there are none.
    """
    if data.times[0] > time:
        raise InputError(
            f"learn.until: expected a time after the first reading at "
            f"{data.times[0]:g} s, got {time:g} s; fit more of them"
        )
    if isinstance(data, Thermometry):
        return data.until(time)
    count = int(np.sum(data.times <= time))
    return ProbeData(data.times[:count], data.points, data.values[:count])


def _read_frames(frames: Frames, setup: Setup, folder: Path) -> Thermometry:
    labels = setup.image
    if labels is None:
        raise InputError(
            "learn.thermometry: expected a grid of voxels, got another; take data, a "
            "CSV file"
        )
    image = read_image(folder / frames.readings)
    check_place(image, labels)
    if image.values.ndim != labels.values.ndim + 1:
        raise InputError(
            f"{image.path}: expected frames along a last axis, got shape "
            f"{image.values.shape}"
        )
    values = np.moveaxis(image.values, -1, 0)
    if np.isinf(values).any():
        raise InputError(
            f"{image.path}: expected numbers, or NaN where a voxel is lost, got "
            "infinity; replace it"
        )
    every = _interval(frames, image)
    turn = frames.turn
    arterial = setup.arterial
    if frames.magnet is not None and frames.echo is not None:
        turn = phase_turn(frames.magnet, frames.echo, frames.coefficient)
        values = -values / (2 * np.pi) * turn  # the shift falls as tissue warms
    if frames.quantity != "temperature":
        values = arterial + values
    _check_warmth(frames, image.path, image.values, values)
    return Thermometry(
        every * np.arange(1, len(values) + 1),
        values,
        _read_noise(frames, labels, folder),
        turn,
        frames.drift,
    )


UNITS = {
    "temperature": "°C; subtract 273.15 from kelvins, or name the quantity",
    "rise": "kelvins above the arteries; subtract what the tissue had at first",
    "phase": "radians; multiply degrees by pi/180",
}
"""Of readings by their quantity, and what to do with those that have another."""


def _check_warmth(
    frames: Frames, path: Path, given: np.ndarray, values: np.ndarray
) -> None:
    """Refuse readings that are no temperature of tissue in the unit that is said."""
    hottest = np.abs(np.nan_to_num(values)).max()
    if hottest <= HOTTEST_READING:
        return
    raise InputError(
        f"{path}: expected a {frames.quantity} in {UNITS[frames.quantity]}; got "
        f"{np.nanmax(np.abs(given)):g}, or {hottest:.4g} °C"
    )


def _interval(frames: Frames, image: Image) -> float:
    """Time between two frames [s]."""
    every = image.every if frames.every is None else frames.every
    if image.every is not None and abs(image.every / (every or 1.0) - 1) > NEGLIGIBLE:
        raise InputError(
            f"learn.thermometry.every: expected {image.every:g} s, that of "
            f"{image.path.name}, got {every:g} s; leave it out, or correct the file"
        )
    if every is None or not np.isfinite(every):
        raise InputError(
            f"{image.path}: expected a time between frames with a unit, or "
            "learn.thermometry.every in the case, got neither; give it in seconds"
        )
    return every


def _read_noise(frames: Frames, labels: Image, folder: Path) -> np.ndarray:
    if not isinstance(frames.noise, str):
        return np.full(labels.values.shape, frames.noise)
    image = read_image(folder / frames.noise)
    check_place(image, labels)
    read = image.values[np.isfinite(image.values)]
    if (
        image.values.shape != labels.values.shape
        or not read.size
        or not (read.min() > 0 and read.max() <= NOISIEST)
    ):
        raise InputError(
            f"{image.path}: expected the standard deviation of each voxel, > 0 and <= "
            f"{NOISIEST:g} K, got another number or frames; make lost voxels NaN"
        )
    return image.values
