"""The cases of a folder: what each recording is, built in or from its `truth.toml`."""

import tomllib
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
from jaxtyping import Float

from pinav.dynamics import thermal_energy
from pinav.errors import InputError
from pinav.trajectories.csv_files import PREFIX

DESCRIPTION = "truth.toml"
"""Name of the file that describes a recording of one's own."""

Kind = Literal["ring", "wall", "trap", "dragged trap"]

LENGTHS = {"um": 1.0, "nm": 1e-3, "mm": 1e3, "m": 1e6, "rad": 1.0}
"""Units of positions, in um (an angle stays one)."""

TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
"""Units of times, in s."""


class Constants(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True
):
    """What is known of an experiment; a key ends with its unit.

    Attributes:
        temperature_K: of the fluid.
        thermal_energy_pN_um: $k_B T$, where it is not that of the temperature.
        radius_um: of the bead.
        viscosity_mPa_s: of the fluid.
        density_excess_kg_m3: of the bead over the fluid.
        ring_radius_um: of a ring whose positions are angles.
        period: of a ring, in the unit of the positions; 2 pi where they are angles.
        diffusion_um2_s: far from a wall, where it is known.
        stiffness_pN_um: of a trap, where it is known from elsewhere.
        stiffness_error_pN_um: its standard deviation.
    """

    temperature_K: float | None = None
    thermal_energy_pN_um: float | None = None
    radius_um: float | None = None
    viscosity_mPa_s: float | None = None
    density_excess_kg_m3: float | None = None
    ring_radius_um: float | None = None
    period: float | None = None
    diffusion_um2_s: float | None = None
    stiffness_pN_um: float | None = None
    stiffness_error_pN_um: float | None = None

    @property
    def heat(self) -> float | None:
        """Thermal energy $k_B T$ [pN um], where the experiment states it."""
        if self.thermal_energy_pN_um is not None:
            return self.thermal_energy_pN_um
        return (
            None if self.temperature_K is None else thermal_energy(self.temperature_K)
        )


class CaseDescription(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True
):
    """What a recording is.

    Attributes:
        kind: what is known of it: "ring", "wall", "trap" or "dragged trap".
        file: name of the recording, text with one header line; .gz is read too.
        time: column of the times; the frames are numbered by `rate_Hz` where it is
            empty.
        positions: columns of positions: x, y, z above a wall (z up), one column for
            each track on a ring, one for a trap.
        drive: column of the commanded trap position.
        length_unit: of the positions.
        time_unit: of the times.
        rate_Hz: frames a second.
        constants: of the experiment.
    """

    kind: Kind
    file: str
    positions: tuple[str, ...]
    time: str = ""
    drive: str = ""
    length_unit: Literal["um", "nm", "mm", "m", "rad"] = "um"
    time_unit: Literal["s", "ms", "us"] = "s"
    rate_Hz: float | None = None
    constants: Constants = Constants()


BUILT_IN = {
    "trap_at_rest": CaseDescription(
        kind="trap",
        file="recording.csv.gz",
        time="t_s",
        positions=("bead_um",),
        constants=Constants(temperature_K=295.15),
    ),
    "dragged_trap": CaseDescription(
        kind="dragged trap",
        file="recording.csv.gz",
        time="t_s",
        positions=("bead_um",),
        drive="trap_um",
        constants=Constants(
            temperature_K=295.15, stiffness_pN_um=1.125, stiffness_error_pN_um=0.0225
        ),
    ),
    "ring_driven_bead": CaseDescription(
        kind="ring",
        file="angles.csv.gz",
        time="t_s",
        positions=tuple(f"angle_{index:02d}_rad" for index in range(39)),
        length_unit="rad",
        constants=Constants(ring_radius_um=4.12, temperature_K=293.15),
    ),
    "wall_bead_60hz": CaseDescription(
        kind="wall",
        file="recording.csv.gz",
        time="t_s",
        positions=("x_um", "y_um", "z_um"),
        constants=Constants(
            thermal_energy_pN_um=4.0e-3,
            radius_um=1.516,
            viscosity_mPa_s=1.0,
            density_excess_kg_m3=50.0,
            diffusion_um2_s=0.14,
        ),
    ),
}
"""Public recordings by the names of their folders; `pinav data list` tells whence they
come. The stiffness of the dragged trap is that of its authors, 1.08 to 1.17 pN/um."""


class Recording(msgspec.Struct, frozen=True):
    """The numbers of a recording, in um (or rad) and s.

    Attributes:
        times: of the frames.
        positions: of the bead, one column for each coordinate or track.
        drive: commanded position of the trap; None where there is none.
    """

    times: Float[np.ndarray, " frame"]
    positions: Float[np.ndarray, "frame column"]
    drive: Float[np.ndarray, " frame"] | None


class Case(msgspec.Struct, frozen=True):
    """A recording in its folder.

    Attributes:
        name: of the folder.
        folder: where it is.
        description: what it is.
    """

    name: str
    folder: Path
    description: CaseDescription

    @property
    def path(self) -> Path:
        """The file of the recording."""
        return self.folder / self.description.file

    def read(self) -> Recording:
        """The recording.

        Raises:
            InputError: the file cannot be read, or lacks a column.
        """
        return read_recording(self.path, self.description)


def find_cases(folder: Path) -> list[Case]:
    """The cases of a folder, those that are absent included; or the one that it is.

    Raises:
        InputError: there is no folder, no case in it, or a description is at fault.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: expected a folder of recordings; check the name")
    if (folder / DESCRIPTION).is_file() or folder.name in BUILT_IN:
        return [Case(folder.resolve().name, folder, describe(folder))]
    described = {path.parent.name for path in folder.glob(f"*/{DESCRIPTION}")}
    names = [*BUILT_IN, *sorted(described - BUILT_IN.keys())]
    cases = [Case(name, folder / name, describe(folder / name)) for name in names]
    if not any(case.path.is_file() for case in cases):
        raise InputError(
            f"{folder}: no recording here; expected folders such as "
            f"{', '.join(BUILT_IN)} (pinav data list tells where they come from), or "
            f"folders with a {DESCRIPTION}"
        )
    return cases


def describe(folder: Path) -> CaseDescription:
    """What the recording of a folder is: its `truth.toml`, or the built-in words.

    Raises:
        InputError: the file cannot be read, or a key or value in it is wrong.
    """
    path = folder / DESCRIPTION
    if not path.is_file():
        return BUILT_IN[folder.name]
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        description = msgspec.convert(table, CaseDescription)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    except msgspec.ValidationError as error:
        raise InputError(f"{path}: {error}") from error
    _check(path, description)
    return description


def _check(path: Path, description: CaseDescription) -> None:
    """Refuse what no single key shows."""
    count, kind = len(description.positions), description.kind
    wanted = {"wall": 3, "trap": 1, "dragged trap": 1}.get(kind, count)
    if count != wanted or count == 0:
        raise InputError(
            f"{path}: positions: expected {wanted or 'some'} columns for a {kind}, got "
            f"{count}"
        )
    if bool(description.drive) != (kind == "dragged trap"):
        raise InputError(f"{path}: drive: a dragged trap has it, and no other kind")
    if not description.time and description.rate_Hz is None:
        raise InputError(f"{path}: time: name a column, or state rate_Hz")
    for name, value in msgspec.to_builtins(description.constants).items():
        if not (np.isfinite(value) and (value > 0 or name.startswith("density"))):
            raise InputError(f"{path}: constants.{name}: expected > 0, got {value}")
    needed = {"trap": "temperature_K", "dragged trap": "temperature_K"}.get(kind)
    if needed and description.constants.heat is None:
        raise InputError(f"{path}: constants.{needed}: this key is missing")
    constants = description.constants
    if kind == "ring" and description.length_unit != "rad" and not constants.period:
        raise InputError(f"{path}: constants.period: this key is missing")
    if kind == "wall" and (constants.radius_um is None or constants.heat is None):
        raise InputError(
            f"{path}: constants: a wall needs radius_um, and temperature_K or "
            "thermal_energy_pN_um"
        )


def read_recording(path: Path, description: CaseDescription) -> Recording:
    """The columns of a recording, in um (or rad) and s.

    Raises:
        InputError: the file cannot be read, lacks a column or holds no numbers.
    """
    try:
        with np.lib.npyio.DataSource().open(str(path), "rt", encoding="utf-8") as file:
            first = file.readline()
            if first.startswith(PREFIX):
                first = file.readline()
            header = [name.strip() for name in first.split(",")]
            wanted = [description.time, *description.positions, description.drive]
            missing = [name for name in wanted if name and name not in header]
            if missing:
                raise InputError(
                    f"{path}: column {missing[0]!r} is missing; expected some of "
                    f"{', '.join(header)}"
                )
            rows = np.loadtxt(file, delimiter=",", ndmin=2)
    except (OSError, ValueError, EOFError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    column = {name: rows[:, index] for index, name in enumerate(header)}
    length = LENGTHS[description.length_unit]
    if description.time:
        times = column[description.time] * TIMES[description.time_unit]
    else:
        times = np.arange(len(rows)) / (description.rate_Hz or 1.0)
    positions = np.stack([column[name] * length for name in description.positions], 1)
    drive = column[description.drive] * length if description.drive else None
    return Recording(times, positions, drive)
