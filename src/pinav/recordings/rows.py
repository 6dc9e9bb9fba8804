"""Rows of positions in the file's own conventions: the result of every format."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, final

import numpy as np
from jaxtyping import Bool, Float64, Int64

from pinav.reading import Reading
from pinav.recordings import units
from pinav.recordings.table import Table
from pinav.trajectories import COMMAND_UNITS as COMMAND_UNITS

FRAMES = "frame"
"""Unit of times that are only numbers of frames."""


@final
@dataclasses.dataclass(frozen=True, eq=False)
class Tracks:
    """Rows of a recording as its file has them: one particle in one frame each.

    Attributes:
        x: in `length_unit`, NaN where the particle was lost; so are y and z.
        place: names the place of a row for messages, such as "line 7".
        particle: name of the particle of each row; one particle if not given.
        segment: number of the stretch between jumps.
        commands: commands by the names of `COMMAND_UNITS`; NaN where the log has none.
        y_down: y grows downwards, as in images.
        columns: the file's names of "frame" and "time".
        facts: further entries of the provenance; JSON values.
        z: height, upwards.
        doubts: doubts for which a fit refuses the recording, by the option that settles
            them.
    """

    x: Float64[np.ndarray, " row"]
    y: Float64[np.ndarray, " row"]
    place: Callable[[int], str]
    particle: list[str] | None = None
    run: list[str] | None = None
    kind: list[str] | None = None
    frame: Int64[np.ndarray, " row"] | None = None
    time: Float64[np.ndarray, " row"] | None = None
    segment: Int64[np.ndarray, " row"] | None = None
    commands: dict[str, Float64[np.ndarray, " row"]] = dataclasses.field(
        default_factory=dict
    )
    length_unit: str = "px"
    time_unit: str = "s"
    y_down: bool = True
    columns: Mapping[str, str] = dataclasses.field(default_factory=dict)
    notes: tuple[str, ...] = ()
    facts: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    z: Float64[np.ndarray, " row"] | None = None
    doubts: Mapping[str, str] = dataclasses.field(default_factory=dict)

    @classmethod
    def of_table(
        cls,
        table: Table,
        headings: Mapping[str, str],
        *,
        scale: float = 1.0,
        **others: Any,
    ) -> "Tracks":
        """The rows of a table.

        Args:
            headings: columns of x, y and of each other quantity.
            others: fields that are known from elsewhere.

        Raises:
            InputError: a column is missing, or a cell is at fault.
        """
        wanted = {name: h for name, h in headings.items() if name not in others}
        read: dict[str, Any] = {}
        for name, heading in wanted.items():
            if name in ("x", "y", "z"):
                read[name] = scale * table.numbers(heading, lost=True)
            elif name in ("particle", "run", "kind"):
                read[name] = table.labels(heading)
            elif name in ("frame", "segment"):
                read[name] = table.whole_numbers(heading, least=0)
        if "t" in headings and "time" not in others:
            read["time"] = table.numbers(headings["t"])
        columns = {"frame": headings.get("frame"), "time": headings.get("t")}
        read["columns"] = {name: h for name, h in columns.items() if h}
        return cls(**{**read, "place": table.row, "notes": table.notes, **others})

    @property
    def names(self) -> list[tuple[str, str, str]]:
        """Run, kind and particle of each row; empty where the file does not say."""
        blank = [""] * len(self.x)
        several = (self.run or blank, self.kind or blank, self.particle or blank)
        return list(zip(*several, strict=True))

    def positions(self) -> Float64[np.ndarray, "row dim"]:
        """x, y and, where there is one, z."""
        heights = [] if self.z is None else [self.z]
        return np.stack([self.x, self.y, *heights], axis=1)

    def select(self, kept: Bool[np.ndarray, " row"]) -> "Tracks":
        """The rows where the mask is true."""
        rows = np.flatnonzero(kept)

        def chosen(name: str) -> Any:
            column = getattr(self, name)
            if isinstance(column, list):
                return [column[row] for row in rows]
            return None if column is None else column[rows]

        columns = ("x", "y", "z", "particle", "run", "kind", "frame", "time", "segment")
        return dataclasses.replace(
            self,
            place=lambda row: self.place(int(rows[row])),
            commands={name: c[rows] for name, c in self.commands.items()},
            **{name: chosen(name) for name in columns},
        )

    def where(self, row: int, what: str) -> str:
        """Place of the frame or the time of a row, for a message."""
        return f"{self.place(row)}, column {self.columns.get(what, what)!r}"


def read_commands(
    table: Table,
    columns: Mapping[str, str],
    stated: Mapping[str, str],
    *,
    lost: bool = True,
) -> dict[str, Float64[np.ndarray, " row"]]:
    """The commands of a table in Hz and rad; NaN for empty cells that may be `lost`.

    Args:
        columns: column of each quantity; those that are no commands are passed over.
        stated: units that stand above those of the table.
    """
    commands = {}
    for name, target in COMMAND_UNITS.items():
        if name in columns:
            unit = stated.get(name) or table.unit(columns[name]) or target
            values = table.numbers(columns[name], lost=lost)
            commands[name] = values * units.command(name, target, unit)
    return commands


def varying(heights: Float64[np.ndarray, " row"]) -> Float64[np.ndarray, " row"] | None:
    """The heights, or None where they are all the same: a film of a plane."""
    known = heights[np.isfinite(heights)]
    return heights if len(known) and np.ptp(known) > 0 else None


def in_known_units(tracks: Tracks, reading: Reading) -> Tracks:
    """The tracks with lengths in px or um and times in s or frames, where possible.

    What the user states of a unit stands above what the file says. `mpp` says that an
    unknown unit is the pixel.
    """
    scale, length_unit = units.stated(reading.units, "x") or (
        1.0,
        "px" if tracks.length_unit == "?" and reading.mpp else tracks.length_unit,
    )
    factor, time_unit = units.stated(reading.units, "t") or (1.0, tracks.time_unit)
    return dataclasses.replace(
        tracks,
        x=scale * tracks.x,
        y=scale * tracks.y,
        z=None if tracks.z is None else scale * tracks.z,
        time=None if tracks.time is None else factor * tracks.time,
        length_unit=length_unit,
        time_unit=time_unit,
    )
