"""Readings of thermometers: the data that thermal models are fitted to, as tables."""

from pathlib import Path

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from pinav.errors import InputError
from pinav.files import write_text
from pinav.recordings.source import Source
from pinav.thermal.quantities import Number

HOTTEST_READING = 150.0
"""Magnitude [°C] of a reading that is taken for kelvins."""

AXES = {("r",): 1, ("x",): 1, ("x", "y"): 2, ("x", "y", "z"): 3}


DRIFTS = ("none", "constant", "linear")
"""What the drift of the field of a magnet is in space, at each frame a new one."""


class Readings(eqx.Module):
    """Temperatures over time, of probes or of every voxel of a grid.

    Attributes:
        times: [s], increasing.
        values: [°C], at each time for each place; NaN where a reading is missing.
        points: places of the probes [m]; None where voxels are read.
        noise: standard deviation of a reading at each place [K]; 1 unless given.
        turn: temperature [K] that a turn of the phase is; None without turns.
        drift: one of `DRIFTS`.

    Raises:
        InputError: times do not increase from above zero, shapes disagree, noise is not
            positive, or nothing was read.
    """

    times: Float[np.ndarray, " time"]
    values: Float[np.ndarray, "..."]
    points: Float[np.ndarray, "probe axis"] | None = None
    noise: Float[np.ndarray, "..."] | None = None
    turn: Number | None = None
    drift: str = eqx.field(static=True, default="none")

    def __check_init__(self) -> None:
        places = self.sd.shape if self.points is None else (len(self.points),)
        if self.values.shape != (shape := (len(self.times), *places)):
            raise InputError(
                f"readings: expected values of shape {shape}, times by places, got "
                f"{self.values.shape}"
            )
        if not (
            len(self.times) and self.times[0] > 0 and np.all(np.diff(self.times) > 0)
        ):
            raise InputError(
                "readings: expected increasing times > 0 s; the state at 0 s is where "
                "a run starts, not a reading"
            )
        if not self.observed.any():
            raise InputError("readings: expected a reading, got none")
        if not np.all(self.sd[self.observed.any(axis=0)] > 0):
            raise InputError(
                "readings: expected a noise > 0 K at every voxel that is read; give "
                "lost voxels no reading"
            )
        if self.turn is not None and not self.turn > 0:
            raise InputError(f"readings: expected a turn > 0 K, got {self.turn:g}")
        if self.drift not in DRIFTS:
            raise InputError(
                f"readings: expected a drift, {', '.join(DRIFTS)}, got {self.drift!r}"
            )

    @property
    def sd(self) -> Float[np.ndarray, "..."]:
        """Standard deviation of a reading at each place [K], or 1."""
        return np.ones(self.values.shape[1:]) if self.noise is None else self.noise

    @property
    def observed(self) -> Bool[np.ndarray, "..."]:
        return np.isfinite(self.values) & np.isfinite(self.sd)

    @property
    def spread(self) -> float:
        """Standard deviation of all readings over their noise; 1 where it is zero."""
        return float((self.values / self.sd)[self.observed].std()) or 1.0

    def until(self, time: Number) -> "Readings":
        """The readings up to a time [s]."""
        kept = self.times <= time * (1 + 1e-9)
        return eqx.tree_at(
            lambda data: (data.times, data.values),
            self,
            (self.times[kept], self.values[kept]),
        )


def place_names(points: Float[np.ndarray, "probe axis"]) -> list[str]:
    """Names of probes by their places [m]."""
    return [", ".join(f"{1e3 * x:g}" for x in point) + " mm" for point in points]


def save_probes(data: Readings, path: Path, *, overwrite: bool = False) -> None:
    """Write a CSV file with the columns t, the coordinates, and T, one reading a row.

    Raises:
        InputError: the file is there and `overwrite` is false.
    """
    assert data.points is not None
    count = data.points.shape[1]
    axes = ("r",) if count == 1 else ("x", "y", "z")[:count]
    lines = [",".join(("t", *axes, "T"))]
    for t, row in zip(data.times, data.values, strict=True):
        for point, value in zip(data.points, row, strict=True):
            cells = [t, *point] + ([value] if np.isfinite(value) else [])
            words = [repr(float(cell)) for cell in cells]
            lines.append(",".join(words + [""] * (len(axes) + 2 - len(words))))
    write_text(path, "\n".join(lines) + "\n", overwrite=overwrite)


def load_probes(path: Path) -> Readings:
    """Read a CSV file: columns t [s], r or x, y, z [m], and T [°C]; empty is missing.

    Raises:
        InputError: the file cannot be read, has other columns, or a cell is no number.
    """
    try:
        table = Source.read(path).table()
        names = tuple(table.columns)
        if names[:1] != ("t",) or names[-1:] != ("T",) or names[1:-1] not in AXES:
            raise InputError(
                "expected the columns t, r, T or t, x, y, z, T, got "
                f"{', '.join(names) or 'none'}"
            )
        columns = [table.numbers(name, lost=name == "T") for name in names]
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return _to_grid(path, np.stack(columns, axis=1))


def _to_grid(path: Path, cells: np.ndarray) -> Readings:
    """One row for each time, one column for each probe, missing where nothing was."""
    _check_rows(path, cells)
    keys, counts = np.unique(cells[:, :-1], axis=0, return_counts=True)
    if counts.max() > 1:
        t, *place = keys[counts.argmax()]
        raise InputError(
            f"{path}: expected one reading for each time and place, got "
            f"{counts.max()} at t = {t:g} s and {place} m; remove or average them"
        )
    times, when = np.unique(cells[:, 0], return_inverse=True)
    points, where = np.unique(cells[:, 1:-1], axis=0, return_inverse=True)
    # What no row names stays NaN, and counts as not read.
    values = np.full((len(times), len(points)), np.nan)
    values[when.reshape(-1), where.reshape(-1)] = cells[:, -1]
    return Readings(times, values, points)


def _check_rows(path: Path, cells: np.ndarray) -> None:
    times, readings = cells[:, 0], cells[:, -1]
    for wrong, expected, values in (
        (times <= 0, "times > 0 s, the begin of the protocol", times),
        (
            np.abs(readings) > HOTTEST_READING,
            "temperatures in °C, which are kelvins less 273.15",
            readings,
        ),
    ):
        if wrong.any():
            row = int(wrong.argmax())
            raise InputError(
                f"{path}, row {row + 2}: expected {expected}, got {values[row]}; "
                "correct or remove the row"
            )
    if not np.isfinite(readings).any():
        raise InputError(
            f"{path}: expected a reading, got empty cells alone; fill the column T"
        )
