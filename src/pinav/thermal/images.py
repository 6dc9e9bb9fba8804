"""Images of voxels, and frames of MR thermometry: arrays of NumPy, and NIfTI.

A NIfTI file says how large its voxels are and where; an array of NumPy says neither.
Everything is in metres and seconds here, whatever the file has.
"""

import gzip
import importlib
from pathlib import Path
from types import ModuleType
from typing import BinaryIO

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.errors import InputError
from pinav.files import atomic_write
from pinav.thermal.case_geometry import Frames
from pinav.thermal.quantities import NOISIEST, Number, read_arrays
from pinav.thermal.readings import HOTTEST_READING, Readings

SPATIAL_UNITS = {"meter": 1.0, "mm": 1e-3, "micron": 1e-6}
TEMPORAL_UNITS = {"sec": 1.0, "msec": 1e-3, "usec": 1e-6}

SMALLEST, LARGEST = 1e-5, 0.05
"""Edges [m] that a voxel may have; others are those of another unit."""

NEGLIGIBLE = 1e-3
"""Relative difference of edges and places, by which rounding makes files differ."""

SUFFIXES = (".npy", ".nii", ".nii.gz")


class Image(eqx.Module):
    """Values of voxels, and where the voxels are as far as the file says it.

    Attributes:
        values: one for each voxel, frames last if there are any.
        spacing: edges of a voxel [m]; None where the file has no unit.
        affine: from indices to places of the scanner [m]; None where it has none.
        every: time between two frames [s]; None where the file does not say.
    """

    path: Path
    values: np.ndarray
    spacing: tuple[float, ...] | None = None
    affine: Float[np.ndarray, "4 4"] | None = None
    every: float | None = None


def read_image(path: Path) -> Image:
    """An image of one of the formats.

    Raises:
        InputError: the file cannot be read, is of another format, or holds no numbers
            on perpendicular axes of plausible voxels.
    """
    if path.name.endswith(".npy"):
        arrays = read_arrays(path)
        if "" not in arrays:
            raise InputError(
                f"{path}: expected one array of NumPy, got several; use np.save"
            )
        return Image(path, _numbers(path, arrays[""]))
    if not path.name.endswith((".nii", ".nii.gz")):
        raise InputError(
            f"{path}: expected a file that ends in {', '.join(SUFFIXES)}, got another; "
            "convert it"
        )
    return _read_nifti(path)


def write_image(path: Path, values: np.ndarray, like: Image) -> None:
    """Write a NIfTI file of voxels that are where those of another image are."""
    assert like.affine is not None
    nibabel = _nibabel(path)
    affine = like.affine.copy()
    affine[:3] *= 1e3
    shape = values.shape + (1,) * (3 - values.ndim)
    image = nibabel.Nifti1Image(values.reshape(shape).astype(np.float32), affine)
    image.header.set_xyzt_units("mm", "sec")
    content = gzip.compress(image.to_bytes(), mtime=0)

    def write(file: BinaryIO) -> None:
        file.write(content)

    atomic_write(path, write, overwrite=True)


def check_place(image: Image, reference: Image) -> None:
    """Refuse an image whose voxels are not those of another."""
    axes = reference.values.ndim
    if image.values.shape[:axes] != reference.values.shape:
        raise InputError(
            f"{image.path}: expected the shape {reference.values.shape} of "
            f"{reference.path.name}, got {image.values.shape}; resample it"
        )
    if image.affine is None or reference.affine is None:
        return
    assert reference.spacing is not None
    apart = np.abs(image.affine - reference.affine)[:3].max()
    if apart > NEGLIGIBLE * max(image.values.shape) * min(reference.spacing):
        raise InputError(
            f"{image.path}: expected the affine of {reference.path.name}, got another "
            f"(up to {1e3 * apart:.3g} mm apart); resample it, or correct its units"
        )


def _numbers(path: Path, values: np.ndarray) -> np.ndarray:
    if values.dtype.kind not in "biuf":
        raise InputError(f"{path}: expected real numbers, got something else")
    return values.astype(float)


def _nibabel(path: Path) -> ModuleType:
    try:
        return importlib.import_module("nibabel")
    except ImportError as error:
        raise InputError(
            f"{path}: NIfTI needs nibabel, which is not installed; pip install "
            "'pinav[mri]', or save arrays of NumPy"
        ) from error


def _read_nifti(path: Path) -> Image:
    nibabel = _nibabel(path)
    try:
        image = nibabel.load(path)
        values = np.asarray(image.dataobj)
        zooms, units = image.header.get_zooms(), image.header.get_xyzt_units()
        affine = np.array(image.affine, float)
    except Exception as error:  # whatever a damaged file makes of it
        raise InputError(f"{path}: cannot be read: {error}") from error
    values = _numbers(path, values)
    if not 3 <= values.ndim <= 4:
        raise InputError(
            f"{path}: expected voxels along three axes, and frames if any, got shape "
            f"{values.shape}"
        )
    values = values[:, :, 0] if values.shape[2] == 1 else values
    every = None
    if len(zooms) == 4 and zooms[3] > 0:
        every = float(zooms[3]) * TEMPORAL_UNITS.get(units[1], np.nan)
    if units[0] not in SPATIAL_UNITS:
        return Image(path, values, every=every)
    factor = SPATIAL_UNITS[units[0]]
    affine[:3] *= factor
    spacing = _spacing(path, affine, factor * np.array(zooms[:3], float), units[0])
    axes = 2 if image.shape[2] == 1 else 3
    return Image(path, values, spacing[:axes], affine, every)


def _spacing(
    path: Path, affine: np.ndarray, zooms: np.ndarray, unit: str
) -> tuple[float, ...]:
    """Edges of a voxel [m], which affine and header agree about."""
    columns = affine[:3, :3]
    edges = np.linalg.norm(columns, axis=0)
    if not np.all((edges >= SMALLEST) & (edges <= LARGEST)):
        raise InputError(
            f"{path}: expected voxels of {1e3 * SMALLEST:g} to {1e3 * LARGEST:g} mm, "
            f"got {_millimetres(edges)}; its unit of length, {unit}, may be wrong"
        )
    if np.abs(edges - zooms).max() > NEGLIGIBLE * edges.min():
        raise InputError(
            f"{path}: expected an affine of voxels as large as in the header, "
            f"{_millimetres(zooms)}, got {_millimetres(edges)}; correct one of them"
        )
    angles = (columns / edges).T @ (columns / edges) - np.eye(3)
    if np.abs(angles).max() > NEGLIGIBLE:
        raise InputError(
            f"{path}: expected an affine with perpendicular axes, got a sheared one; "
            "resample the image"
        )
    return tuple(edges.tolist())


def _millimetres(edges: np.ndarray) -> str:
    return " x ".join(f"{1e3 * edge:.4g}" for edge in edges) + " mm"


GYROMAGNETIC = 42.577478518e6
"""Frequency of protons over the field of the magnet [Hz T⁻¹]."""


def phase_turn(field: Number, echo: Number, coefficient: Number = -1e-8) -> float:
    r"""Temperature of a turn of the phase [K], $1/|\gamma\alpha B_0 t_E|$.

    Args:
        field: $B_0$ [T].
        echo: $t_E$ [s].
        coefficient: $\alpha$, change of the shift with temperature [K⁻¹].
    """
    return 1 / abs(GYROMAGNETIC * coefficient * field * echo)


def read_frames(
    frames: Frames, labels: Image | None, arterial: float, folder: Path
) -> Readings:
    """Frames of thermometry that a case names."""
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
    if frames.magnet is not None and frames.echo is not None:
        turn = phase_turn(frames.magnet, frames.echo, frames.coefficient)
        values = -values / (2 * np.pi) * turn  # the shift falls as tissue warms
    if frames.quantity != "temperature":
        values = arterial + values
    _check_warmth(frames, image.path, image.values, values)
    return Readings(
        every * np.arange(1, len(values) + 1),
        values,
        noise=_read_noise(frames, labels, folder),
        turn=turn,
        drift=frames.drift,
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
