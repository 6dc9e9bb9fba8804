"""Tables of a tracker's file: named columns, synonyms, and places of rows."""

import dataclasses
import datetime
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, final

import numpy as np
from jaxtyping import Float64, Int64

from pinav.errors import InputError
from pinav.recordings import units

SYNONYMS: Mapping[str, tuple[str, ...]] = {
    "t": ("t", "t s", "time", "times", "timestamp", "time stamp", "seconds", "zeit"),
    "frame": ("frame", "frames", "slice", "image", "frame number", "imagenumber"),
    "x": ("x", "x um", "x px", "pos x", "posx", "xpos", "position x", "x position"),
    "y": ("y", "y um", "y px", "pos y", "posy", "ypos", "position y", "y position"),
    "z": ("z", "z um", "pos z", "posz", "zpos", "position z", "z position"),
    "particle": (
        *("particle", "id", "track", "track id", "trackid", "trajectory", "tid"),
        *("robot", "bot"),
    ),
    "run": ("run", "experiment", "movie", "video"),
    "frequency": ("frequency", "freq", "freq hz", "f", "rolling frequency", "drive"),
    "heading": ("heading", "alpha", "alpha rad", "angle", "angle rad", "azimuth"),
    "gamma": ("gamma", "gamma rad"),
    "psi": ("psi", "psi rad"),
    "field_x": ("field x", "bx"),
    "field_y": ("field y", "by"),
    "field_z": ("field z", "bz"),
    "acoustic_frequency": ("acoustic frequency", "acoustic hz"),
}
"""Names in small letters, without units, words parted by spaces."""


def likely_columns(names: Sequence[str]) -> dict[str, str]:
    """The column that each quantity probably has; none where no name says so."""
    likely = {}
    for quantity, words in SYNONYMS.items():
        short = {name: _without_qualifiers(name, quantity) for name in names}
        match = [name for word in words for name in names if short[name] == word]
        if match:
            likely[quantity] = match[0]
    return likely


_OF_COMMANDS = (
    r"field(?! [xyz]\b)|magnetic|coil|command|commanded|set|rotation|rotating"
)
_OF_POSITIONS = "centroid|wcentroid|center|centre|mean|spot|particle|robot"
_POSITIONS = ("x", "y", "z", "particle")


def _without_qualifiers(name: str, quantity: str) -> str:
    """A name without the words that do not change what a quantity is."""
    plain = _plain(name)
    if any(plain in words for words in SYNONYMS.values()):
        return plain
    words = _OF_POSITIONS if quantity in _POSITIONS else _OF_COMMANDS
    return re.sub(rf" *\b({words})\b *", " ", plain).strip()


def _plain(name: str) -> str:
    return re.sub(r"[\s_.#\-]+", " ", units.split_heading(name)[0]).strip().lower()


def example_of_columns(names: Sequence[str]) -> str:
    """The option `--columns` to start from."""
    likely = likely_columns(names)
    if "t" in likely:
        likely.pop("frame", None)
    wanted = ["t" if "frame" not in likely else "frame", "x", "y"]
    rest = [name for name in names if name and name not in likely.values()]
    for quantity in wanted:
        if quantity not in likely:
            likely[quantity] = rest.pop(0) if rest else "?"
    order = [*wanted, *(q for q in likely if q not in wanted)]
    words = [f"{q}={likely[q]}" for q in order]
    return "--columns " + " ".join(f"'{w}'" if " " in w else w for w in words)


_LOST = ("", "nan", "na", "n/a", "n.a.", "#n/a", "none", "null", "-", "--", "?")
"""Words for a number that is not there, in lower case."""


@final
@dataclasses.dataclass(frozen=True, eq=False)
class Table:
    """Columns of cells, which may be text, numbers or empty.

    Attributes:
        rows: number of each row in the file, for messages; its whole place where
            `place` is empty.
        place: word for a row, such as "line" or "sheet 'Robot 1', row".
        units: units that a heading, or the row below it, states.
        faults: collects bad cells by the place of their row; the first is refused if
            None.
    """

    columns: Mapping[str, Sequence[Any] | np.ndarray]
    rows: np.ndarray
    place: str = "line"
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    faults: dict[str, str] | None = None
    notes: tuple[str, ...] = ()

    @classmethod
    def concatenate(cls, tables: Sequence["Table"]) -> "Table":
        """The rows of tables with the same columns, one table after the other."""
        places = [table.row(row) for table in tables for row in range(len(table))]
        columns = {
            name: [cell for table in tables for cell in table.columns[name]]
            for name in tables[0].columns
        }
        rows = np.array(places, object)
        return dataclasses.replace(tables[0], columns=columns, rows=rows, place="")

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.rows)

    def row(self, row: int) -> str:
        """Place of a row, for a message."""
        return f"{self.place} {self.rows[row]}".lstrip()

    def where(self, row: int, column: str) -> str:
        """Place of a cell, for a message."""
        return f"{self.row(row)}, column {column!r}"

    def refuse(self, row: int, message: str) -> None:
        """Note the fault of a row, which is then left out, or raise it."""
        if self.faults is None:
            raise InputError(message)
        self.faults.setdefault(self.row(row), message)

    def resolve(self, name: str) -> str:
        """The heading that a name stands for: itself, or itself with a unit."""
        if name in self.columns:
            return name
        same = [h for h in self.columns if units.split_heading(h)[0] == name]
        return same[0] if len(same) == 1 else name

    def unit(self, name: str) -> str:
        """The unit that the table states of a column; empty where it states none."""
        name = self.resolve(name)
        return self.units.get(name, "") or units.split_heading(name)[1]

    def column(self, name: str) -> Sequence[Any] | np.ndarray:
        """The cells of a column, named with or without its unit."""
        name = self.resolve(name)
        if name not in self.columns:
            raise InputError(
                f"{self.header}: column {name!r} is missing; got "
                f"{', '.join(map(str, self.columns)) or 'none'}; add it, or name "
                "another by a column map"
            )
        return self.columns[name]

    @property
    def header(self) -> str:
        """Place of the names of the columns, for a message."""
        return "header" if self.place == "line" else self.place.removesuffix(", row")

    def numbers(self, name: str, *, lost: bool = False) -> Float64[np.ndarray, " row"]:
        """The numbers of a column; empty cells become NaN where they may be `lost`."""
        cells = self.column(name)
        values = _as_floats(cells)
        if values is not None:
            known = values[np.isfinite(values)] if lost else values
            if np.all(np.abs(known) < LARGEST):
                return values
        several = enumerate(cells)
        numbers = [self._number(i, name, cell, lost=lost) for i, cell in several]
        return np.array(numbers, np.float64)

    def _number(self, row: int, name: str, cell: Any, *, lost: bool) -> float:
        text = "" if cell is None else str(cell).strip()
        empty = text.lower() in _LOST
        if empty and lost:
            return math.nan
        try:
            number = math.nan if "_" in text else float(text)
        except ValueError:
            number = math.nan
        if abs(number) < LARGEST:
            return number
        shown = repr(text) if text else "an empty cell"
        remedy = (
            "write decimals with a point"
            if "," in text
            else "write stamps of a clock as 13:30:01.5 or 2024-05-01T13:30:01"
            if ":" in text
            else "correct the cell"
            if lost
            else "give its value or delete the row"
        )
        wanted = f"a number below {LARGEST:g}" if math.isfinite(number) else FINITE
        self.refuse(
            row, f"{self.where(row, name)}: expected {wanted}, got {shown}; {remedy}"
        )
        return math.nan

    def times(self, name: str) -> tuple[Float64[np.ndarray, " row"], str]:
        """The times of a column, and "s" where they were time stamps.

        Stamps such as `12:30:01.5`, `2:05.31` (minutes and seconds) or
        `2024-03-20T15:10:30.5` become seconds since the first of them; a clock that
        passes midnight goes on.
        """
        cells = self.column(name)
        first = next((cell for cell in cells if _stamp(cell) is not None), None)
        if first is None or _as_floats(cells) is not None:
            return self.numbers(name), ""
        stamps = [_stamp(cell) for cell in cells]
        for row, (cell, stamp) in enumerate(zip(cells, stamps, strict=True)):
            if stamp is None:
                self.refuse(
                    row,
                    f"{self.where(row, name)}: expected a time of day such as "
                    f"12:30:01.5, got {cell!r}; correct the cell",
                )
        seconds = np.array([math.nan if s is None else s for s in stamps], np.float64)
        known = seconds[np.isfinite(seconds)]
        if known.max() < _DAY:
            steps = np.diff(seconds, prepend=seconds[:1])
            seconds = seconds + _DAY * np.cumsum(np.nan_to_num(steps) < -_DAY / 2)
        return seconds - known[0], "s"

    def whole_numbers(
        self, name: str, *, least: int | None = None
    ) -> Int64[np.ndarray, " row"]:
        """The whole numbers of a column, such as frames, none below `least`."""
        values = self.numbers(name)
        wrong = (values != np.round(values)) | (np.abs(values) > 2.0**53)
        if least is not None:
            wrong |= values < least
        expected = "a whole number" + ("" if least is None else f" >= {least}")
        for row in np.flatnonzero(wrong).tolist():
            if np.isnan(values[row]):
                continue  # noted already
            self.refuse(
                row,
                f"{self.where(row, name)}: expected {expected}, got {values[row]:g}; "
                "correct the cell or delete the row",
            )
        return np.where(wrong, -1.0, values).astype(np.int64)

    def labels(self, name: str) -> list[str]:
        """The words of a column that tells things apart; 3.0 and 3 are one word."""
        words = [_label(cell) for cell in self.column(name)]
        for row, word in enumerate(words):
            if not word:
                self.refuse(
                    row,
                    f"{self.where(row, name)}: expected a name or a number, got an "
                    "empty cell; fill it or delete the row",
                )
        return words

    def select(self, chosen: np.ndarray) -> "Table":
        """The rows at these indices, or where this mask is true."""
        columns = {
            name: np.asarray(cells, None if isinstance(cells, np.ndarray) else object)[
                chosen
            ]
            for name, cells in self.columns.items()
        }
        return dataclasses.replace(self, columns=columns, rows=self.rows[chosen])


_DAY = 86_400.0


def _stamp(cell: Any) -> float | None:
    """Seconds of a stamp of a clock, with or without its date; else None."""
    if isinstance(cell, datetime.time):
        return _seconds_of_day(cell)
    if isinstance(cell, datetime.timedelta):
        return cell.total_seconds()
    if isinstance(cell, str) and ":" in cell:
        text = cell.strip().replace(",", ".")
        elapsed = _ELAPSED.fullmatch(text)
        if elapsed:
            return 60.0 * float(elapsed[1]) + float(elapsed[2])
        if text.count(":") == 1:
            return None  # minutes and seconds, or hours and minutes
        try:
            cell = datetime.datetime.fromisoformat(text)
        except ValueError:
            try:
                return _seconds_of_day(
                    datetime.time.fromisoformat("0" * (text[1] == ":") + text)
                )
            except ValueError:
                return None
    if isinstance(cell, datetime.datetime):
        day = datetime.datetime.combine(cell.date(), datetime.time())
        return (
            _DAY * cell.toordinal() + (cell.replace(tzinfo=None) - day).total_seconds()
        )
    return None


_ELAPSED = re.compile(r"(\d+):([0-5]?\d\.\d+)")
"""Minutes and seconds; two whole numbers could be hours and minutes as well."""


def _seconds_of_day(time: datetime.time) -> float:
    return (
        3600.0 * time.hour + 60.0 * time.minute + time.second + 1e-6 * time.microsecond
    )


FINITE = "a finite number"

LARGEST = 1e100
"""Largest number of a recording: squares of larger ones overflow."""


def _as_floats(cells: Sequence[Any] | np.ndarray) -> np.ndarray | None:
    """All cells at once as numbers, or None where one of them needs a closer look."""
    if isinstance(cells, np.ndarray) and cells.dtype.kind in "fiub":
        values = cells.astype(np.float64)
        return None if np.isinf(values).any() else values
    if any(isinstance(cell, str) and "_" in cell for cell in cells):
        return None
    try:
        values = np.array(cells, np.float64)
    except (TypeError, ValueError):
        return None
    return None if values.ndim != 1 or np.isinf(values).any() else values


def _label(cell: Any) -> str:
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return ""
    if isinstance(cell, float | np.floating) and float(cell).is_integer():
        cell = int(cell)
    text = str(cell).strip()
    whole, point, zeros = text.partition(".")
    return whole if point and whole.isdigit() and not zeros.strip("0") else text
