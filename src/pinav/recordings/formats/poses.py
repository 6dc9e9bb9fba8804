"""Body parts: DeepLabCut as CSV or HDF5, and the analysis files of SLEAP."""

import csv
import io
import pickle
from collections.abc import Sequence
from typing import Any, NoReturn, final

import numpy as np

from pinav.errors import InputError
from pinav.recordings.formats.zarr_arrays import open_group
from pinav.recordings.rows import Tracks
from pinav.recordings.source import AbstractFormat, Source
from pinav.recordings.table import Table

_LEVELS = ("scorer", "individuals", "bodyparts", "coords")
_COORDS = ("x", "y", "likelihood")


@final
class DeepLabCut(AbstractFormat):
    """Header rows `scorer`, (`individuals`,) `bodyparts`, `coords`; pixels, y down.

    Each body part of each individual is a particle. Where the likelihood is below that
    of the reading, the position counts as lost.
    """

    name = "deeplabcut"

    def suits(self, source: Source) -> bool:
        if source.kind == "hdf5":
            return not source.content.startswith(b"MATLAB")
        first = [line.split(",")[0] for line in source.first_lines[:3]]
        return first[:1] == ["scorer"] or "bodyparts" in first

    def tracks(self, source: Source) -> Tracks:
        read = _from_hdf5 if source.kind == "hdf5" else _from_csv
        frame, parts = read(source)
        likelihood = source.reading.likelihood
        table = Table.concatenate(list(parts.values()))
        observed = _is_observed(table, likelihood)
        x, y = (np.where(observed, table.numbers(c, lost=True), np.nan) for c in "xy")
        lost = int((~observed).sum())
        return Tracks(
            x=x,
            y=y,
            place=table.row,
            particle=[name for name in parts for _ in frame],
            frame=np.tile(frame, len(parts)),
            notes=(f"{lost} positions of likelihood < {likelihood:g} are lost",)
            * (lost > 0),
            facts={"likelihood": likelihood},
        )


def _is_observed(table: Table, threshold: float) -> np.ndarray:
    """Mask of a sufficient likelihood, which must be one."""
    values = table.numbers("likelihood", lost=True)
    wrong = (values < 0) | (values > 1)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"{table.where(row, 'likelihood')}: expected from 0 to 1, got "
            f"{values[row]:g}; are the columns in order?"
        )
    return np.nan_to_num(values) >= threshold


def _from_csv(source: Source) -> tuple[np.ndarray, dict[str, Table]]:
    lines = source.text.splitlines()
    head = list(csv.reader(lines[: len(_LEVELS)]))
    levels = {row[0].strip(): row[1:] for row in head if row and row[0] in _LEVELS}
    for level in ("scorer", "bodyparts", "coords"):
        if level not in levels:
            place = _LEVELS.index(level) - (level != "scorer")
            got = head[place][0] if place < len(head) and head[place] else ""
            raise InputError(
                f"line {1 + place}: expected the header row {level!r}, got {got!r}; "
                "export it again"
            )
    names = _names(levels)
    width = len(levels["coords"])
    if width == 0 or len(names) != width:
        expected = len(names) or len(levels["bodyparts"])
        raise InputError(
            f"line {len(levels)}: expected {expected} cells, got {width}; is the "
            "header cut short?"
        )
    unique = [f"c{index}" for index in range(width)]
    table = source.read_text_table(skip=len(levels) - 1, names=["frame", *unique])
    columns = [table.columns[name] for name in unique]
    return table.whole_numbers("frame", least=0), _parts(names, columns, table)


def _names(levels: dict[str, list[str]]) -> list[tuple[str, str]]:
    """Particle and coordinate of each column."""
    parts = levels["bodyparts"]
    owners = levels.get("individuals", [""] * len(parts))
    return [
        (f"{owner} {part}".strip(), coord.strip())
        for owner, part, coord in zip(owners, parts, levels["coords"], strict=False)
    ]


def _parts(
    names: Sequence[tuple[str, str]], columns: Sequence[Any], table: Table
) -> dict[str, Table]:
    particles: dict[str, dict[str, Sequence[Any] | np.ndarray]] = {}
    for (name, coord), cells in zip(names, columns, strict=True):
        if coord in particles.setdefault(name, {}):
            raise InputError(f"header: {name!r} has {coord!r} twice; delete one")
        particles[name][coord] = cells
    for name, columns_of in particles.items():
        for coord in _COORDS:
            if coord not in columns_of:
                raise InputError(
                    f"header: column {coord!r} of {name!r} is missing; got "
                    f"{', '.join(columns_of)}; export the file again"
                )
    return {
        name: Table(columns_of, table.rows, f"{name!r}, {table.place}")
        for name, columns_of in particles.items()
    }


def _from_hdf5(source: Source) -> tuple[np.ndarray, dict[str, Table]]:
    """A table of pandas, read as arrays: `table` (of DeepLabCut) or fixed format."""
    with open_group(source.content) as file:
        groups = [g for g in file.values() if "pandas_type" in getattr(g, "attrs", {})]
        if len(groups) != 1 or "table" not in groups[0]:
            raise InputError(
                f"keys {', '.join(file) or 'none'}: expected one table of pandas, as "
                "DeepLabCut writes it; export it as CSV"
            )
        table = groups[0]["table"]
        block = [n for n in table.dtype.names or () if n.startswith("values_block_")]
        if len(block) != 1 or not len(table):
            raise InputError(
                f"table: expected one block of numbers with rows, got {len(block)} "
                f"blocks and {len(table)} rows; export it as CSV"
            )
        values = np.asarray(table[block[0]], np.float64)
        frame = np.asarray(table["index"])
        named = table.attrs[f"{block[0]}_kind"]
    columns = _column_names(bytes(named))
    if len(columns) != values.shape[1]:
        raise InputError(
            f"table: {len(columns)} names for {values.shape[1]} columns; export as CSV"
        )
    frames = Table({"frame": frame}, np.arange(len(frame)), "row")
    names = [(" ".join(words[1:-1]), words[-1]) for words in columns]
    return frames.whole_numbers("frame", least=0), _parts(names, list(values.T), frames)


class _Words(pickle.Unpickler):
    """Makes words, numbers, tuples and lists; a name of anything else is refused."""

    def find_class(self, module: str, name: str) -> NoReturn:
        raise pickle.UnpicklingError(f"unexpected name {module}.{name}")


def _column_names(content: bytes) -> list[tuple[str, ...]]:
    """The list of tuples of words that pandas keeps as a serialised object."""
    try:
        names = _Words(io.BytesIO(content)).load()
    except Exception as error:  # whatever a damaged object leads to
        raise InputError(
            f"table: its names of columns cannot be read ({error}); export it as CSV"
        ) from error
    if not isinstance(names, list) or not all(
        isinstance(words, tuple)
        and len(words) in (3, 4)
        and all(isinstance(word, str) for word in words)
        for words in names
    ):
        raise InputError(
            "table: expected columns named by scorer, body part and coordinate; "
            "export it as CSV"
        )
    return names


@final
class Sleap(AbstractFormat):
    """`tracks` (track, axis, node, frame), `node_names`, `point_scores`; px, y down.

    Each node of each track is a particle, named by both where there are several nodes.
    Points with a score below the likelihood of the reading are lost.
    """

    name = "sleap"

    def suits(self, source: Source) -> bool:
        return source.kind == "hdf5" and b"node_names" in source.content

    def tracks(self, source: Source) -> Tracks:
        with open_group(source.content) as file:
            if "tracks" not in file or "node_names" not in file:
                raise InputError(
                    f"groups {', '.join(file)}: expected tracks and node_names; export "
                    "an analysis file (sleap-convert --format analysis)"
                )
            points = np.asarray(file["tracks"], np.float64)
            nodes = [_text(name) for name in file["node_names"]]
            names = [_text(name) for name in file.get("track_names", ())]
            scores = file.get("point_scores")
            scores = None if scores is None else np.asarray(scores, np.float64)
        if points.ndim != 4 or points.shape[1:3] != (2, len(nodes)):
            raise InputError(
                f"tracks: expected the shape (track, 2, {len(nodes)} nodes, frame), "
                f"got {points.shape}; export the analysis file again"
            )
        count, _, parts, frames = points.shape
        names = names if len(names) == count else [str(i) for i in range(count)]
        labels = [n if parts == 1 else f"{n} {part}" for n in names for part in nodes]
        # One row of positions for each track and node.
        x, y = (points[:, axis].reshape(count * parts, frames) for axis in (0, 1))
        lost = np.isnan(x) | np.isnan(y)
        if scores is not None and scores.shape == (count, parts, frames):
            lost |= ~(scores.reshape(x.shape) >= source.reading.likelihood)
        places = [f"{label!r}, frame" for label in labels]
        return Tracks(
            x=np.where(lost, np.nan, x).ravel(),
            y=np.where(lost, np.nan, y).ravel(),
            place=lambda row: f"{places[row // frames]} {row % frames}",
            particle=[label for label in labels for _ in range(frames)],
            frame=np.tile(np.arange(frames), count * parts),
            facts={"likelihood": source.reading.likelihood},
        )


def _text(value: Any) -> str:
    return value.decode() if isinstance(value, bytes) else str(value)
