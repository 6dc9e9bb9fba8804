"""Tables and lines of text that are known by the names of their columns."""

import dataclasses
import itertools
import re
from collections.abc import Collection, Mapping, Sequence
from typing import final

import numpy as np

from pinav.errors import InputError
from pinav.recordings import units
from pinav.recordings.formats.column_map import long_table
from pinav.recordings.rows import Tracks, read_commands, varying
from pinav.recordings.source import AbstractFormat, Source
from pinav.recordings.table import Table


@final
@dataclasses.dataclass(frozen=True)
class KnownTable(AbstractFormat):
    """A table that is known by its columns, one value for each program; y down.

    Attributes:
        columns: headings of each quantity, separated by strokes; a star stands for the
            number of a particle with columns of its own.
        optional: quantities that the table may lack.
        behind: pattern of permitted text after a heading.
        signs: columns that identify the program when the column of particles is
            missing.
        length_unit: unit of the positions, where no column states it.
        unit_column: heading of a column that states the unit of length.
        untracked: label of rows without a track.
        pixels: beginning of the heading of frames in a table whose positions are pixels
            whatever `length_unit` says.
        remedy: advice on the program's export where a column is missing.
    """

    name: str
    columns: Mapping[str, str]
    _: dataclasses.KW_ONLY
    optional: Collection[str] = ()
    behind: str = ""
    signs: Collection[str] = ()
    length_unit: str = "px"
    unit_column: str = ""
    untracked: str = ""
    pixels: str = ""
    remedy: str = "export it again"

    def suits(self, source: Source) -> bool:
        names = source.column_names
        lacks = set(self._lacking(self._headings(names)))
        return not lacks or (lacks == {"particle"} and bool({*names} & {*self.signs}))

    def _headings(self, names: list[str]) -> dict[str, str]:
        headings = {}
        for quantity, words in self.columns.items():
            if "*" in words:
                one = re.compile(re.escape(words).replace(r"\*", r"\d+"))
                match = [words] if any(map(one.fullmatch, names)) else []
            else:
                one = re.compile(f"({words})({self.behind})?")
                match = [name for name in names if one.fullmatch(name)]
            if match:
                headings[quantity] = match[0]
        return headings

    def _lacking(self, headings: Mapping[str, str]) -> list[str]:
        """Quantities without a column that the table must have."""
        return [q for q in self.columns if q not in headings and q not in self.optional]

    def tracks(self, source: Source) -> Tracks:
        table = source.table()
        headings = self._headings(list(table.columns))
        for quantity in self._lacking(headings):
            words = self.columns[quantity].replace("|", "' or '")
            raise InputError(
                f"{table.header}: column '{words}' is missing; got "
                f"{', '.join(table.columns)}; {self.remedy}"
            )
        table, headings = long_table(table, headings)
        unit = self.length_unit
        if self.unit_column in table.columns:
            unit = str(table.columns[self.unit_column][0])
        if self.pixels and headings["frame"].startswith(self.pixels):
            unit = "px"
        if self.untracked:
            table = tracked(table, headings["particle"], self.untracked)
        factor, length_unit = units.length(unit)
        z = table.numbers(headings["z"], lost=True) if "z" in headings else None
        return Tracks.of_table(
            table,
            headings,
            scale=factor,
            z=None if z is None or varying(z) is None else factor * z,
            length_unit=length_unit,
        )


def tracked(table: Table, column: str, untracked: str) -> Table:
    """The rows that belong to a track."""
    words = [str(cell or "").strip() for cell in table.column(column)]
    return table.select(np.array([word not in ("", untracked) for word in words]))


IMARIS = KnownTable(
    "imaris",
    {
        "x": "Position X",
        "y": "Position Y",
        "z": "Position Z",
        "frame": "Time",
        "particle": "TrackID|Parent",
    },
    length_unit="um",
    unit_column="Unit",
)
"""`Position.csv`: titles, `Position X` ... `Time` (a frame), `TrackID`, `Unit`."""

CELLPROFILER = KnownTable(
    "cellprofiler",
    {
        "x": "Location_Center_X|AreaShape_Center_X",
        "y": "Location_Center_Y|AreaShape_Center_Y",
        "frame": "ImageNumber",
        "particle": "TrackObjects_Label",
    },
    behind=r"_\d+",
    untracked="nan",
)
"""Objects: `ImageNumber`, `Location_Center_X`, `TrackObjects_Label_50`; px."""

NAPARI = KnownTable(
    "napari",
    {"x": "x", "y": "y", "z": "z", "frame": "t", "particle": "ID|track_id"},
)
"""Tracks of btrack or napari with z: `ID, t, x, y, z`, t a frame; px."""

NAPARI_PLANE = KnownTable(
    "napari-plane", {"x": "x", "y": "y", "frame": "t", "particle": "ID|track_id"}
)
"""The same without z."""

IDTRACKER = KnownTable("idtracker.ai", {"t": "seconds|time", "x": "x*", "y": "y*"})
"""`trajectories.csv`: seconds and the columns x1, y1, x2, y2...; px."""

TREX_TABLE = KnownTable(
    "trex-csv",
    {"x": "X#wcentroid", "y": "Y#wcentroid", "frame": "frame", "t": "time"},
    behind=r" \(cm\)",
    length_unit="cm",
)
"""One individual as TRex exports it to CSV: cm, seconds."""

TRACKPY = KnownTable(
    "trackpy",
    {"frame": "frame", "particle": "particle", "x": "x", "y": "y", "z": "z"},
    optional=("z",),
    signs=("mass", "size", "ecc", "signal", "raw_mass", "ep"),
    remedy="link the features first (trackpy.link)",
)
"""Results of `trackpy.link`, as CSV, parquet or DataFrame; px."""

IMAGEJ = KnownTable(
    "imagej",
    {"x": "X|XM", "y": "Y|YM", "frame": "Slice|Frame", "particle": "Track|Particle"},
    optional=("particle",),
    behind=" n.*",
    length_unit="?",
    pixels="Slice n",
    remedy="tick centroid and stack position in Set Measurements",
)
"""`X, Y` or `XM, YM` with a `Slice` (Results); `Track n°, Slice n°, X, Y` by hand.

Results do not say whether they are calibrated: state `units={"x": "px"}` or give `mpp`.
Those without a column `Track` are of one particle.
"""


TIDY_COMMANDS: Mapping[str, str] = {
    "frequency": "freq_hz",
    "heading": "alpha_rad",
    "gamma": "gamma_rad",
    "psi": "psi_rad",
    "field_x": "bx",
    "field_y": "by",
    "field_z": "bz",
    "acoustic_frequency": "acoustic_hz",
}
"""Column of each command."""


@final
class Tidy(AbstractFormat):
    """`t_s, x_um, y_um` (y up) or `x_px, y_px` (y down), and what else is known.

    Optional: `run, kind, particle, segment, frame` and the columns of `TIDY_COMMANDS`.
    Micrometres are taken where there are any, unless `mpp` asks for pixels.
    """

    name = "tidy"

    def suits(self, source: Source) -> bool:
        names = set(source.column_names)
        return "t_s" in names and bool({"x_um", "y_um", "x_px", "y_px"} & names)

    def tracks(self, source: Source) -> Tracks:
        table = source.table()
        has = table.columns
        in_um = "x_um" in has and not (source.reading.mpp and "x_px" in has)
        unit = "um" if in_um else "px"
        if not {f"x_{unit}", f"y_{unit}"} & set(has):
            raise InputError(
                "header: expected positions in columns x_um, y_um or x_px, y_px, got "
                f"{', '.join(has)}; a log of commands alone is no recording"
            )
        others = ("run", "kind", "particle", "segment", "frame")
        columns = {"x": f"x_{unit}", "y": f"y_{unit}", "t": "t_s"}
        return Tracks.of_table(
            table,
            columns | {name: name for name in others if name in has},
            commands=read_commands(
                table, {n: c for n, c in TIDY_COMMANDS.items() if c in has}, {}
            ),
            length_unit=unit,
            y_down=not in_um,
        )


_PREFIX = re.compile(r"^(?:TG|TP|G|P)_")
"""Marks extra columns: global, of a time, of a particle, or of both."""


@final
class SFI(AbstractFormat):
    """`# dt: 0.01` above `particle_id, frame, x, y`, in units that nobody states.

    Time is frame times dt, y points as it is. An extra column with the name of a
    command, such as `TG_frequency`, is that command.

    References:
        Frishman and Ronceray, Phys. Rev. X 10, 021009 (2020).
    """

    name = "sfi"

    def suits(self, source: Source) -> bool:
        lines = (line for line in source.first_lines if not line.startswith("#"))
        return {"particle_id", "frame"} <= set(next(lines, "").split(","))

    def tracks(self, source: Source) -> Tracks:
        lines = source.text.splitlines()
        comments = [*itertools.takewhile(lambda line: line.startswith("#"), lines)]
        table = source.read_text_table(skip=len(comments))
        facts = dict(_entry(line) for line in comments if ":" in line)
        frame, time = table.whole_numbers("frame", least=0), None
        if "dt" in facts:
            time = frame * units.interval("comment 'dt'", facts["dt"])
        extras = {_PREFIX.sub("", name): name for name in table.columns}
        return Tracks.of_table(
            table,
            {"x": "x", "y": "y", "particle": "particle_id", "frame": "frame"},
            frame=frame,
            time=time,
            time_unit="?",
            length_unit="?",
            y_down=False,
            commands=read_commands(table, extras, {}),
            facts={"comments": facts},
        )


def _entry(line: str) -> tuple[str, str]:
    key, _, value = line.lstrip("# ").partition(":")
    return key.strip(), value.strip()


@final
class MTrackJ(AbstractFormat):
    """Lines `Assembly`, `Cluster`, `Track` and `Point index x y z frame channel`.

    The file does not say whether positions are pixels or calibrated: state
    `units={"x": "px"}` or give `mpp`. y is down; z is kept where it varies.
    """

    name = "mtrackj"

    def suits(self, source: Source) -> bool:
        return source.first_lines[:1] != [] and source.first_lines[0].startswith(
            "MTrackJ"
        )

    def tracks(self, source: Source) -> Tracks:
        cluster, track = "1", "1"
        rows: list[int] = []
        points: list[list[str]] = []
        for line, text in enumerate(source.text.splitlines(), start=1):
            kind, *words = text.split() or [""]
            if kind == "Cluster" and words:
                cluster = words[0]
            elif kind == "Track" and words:
                track = words[0]
            elif kind == "Point":
                if len(words) < 5:
                    raise InputError(
                        f"line {line}: expected Point index x y z frame, got {text!r}"
                    )
                rows.append(line)
                points.append([f"{cluster}.{track}", *words[1:5]])
        if not points:
            raise InputError("no line begins with Point; save the tracks again")
        names = ("particle", "x", "y", "z", "frame")
        columns = zip(*points, strict=True)
        cells: dict[str, Sequence[str]] = dict(zip(names, columns, strict=True))
        table = Table(cells, np.array(rows), faults=source.faults)
        z = varying(table.numbers("z"))
        headings = {name: name for name in names}
        return Tracks.of_table(table, headings, z=z, length_unit="?")


DESCRIBED = (TREX_TABLE, IMARIS, CELLPROFILER, NAPARI, NAPARI_PLANE, IDTRACKER, TRACKPY)
"""Tables of columns, in the order in which a file is tried."""
