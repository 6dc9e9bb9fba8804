"""A tracker's file before its format is known, and what a format is to pinav."""

import abc
import dataclasses
import gzip
import io
import os
import re
import zlib
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Protocol, final, runtime_checkable

import numpy as np

from pinav.errors import InputError
from pinav.recordings import layout
from pinav.recordings.rows import Reading, Tracks
from pinav.recordings.table import Table

Kind = Literal[
    "text",
    "xml",
    "workbook",
    "zip",
    "hdf5",
    "parquet",
    "matlab",
    "array",
    "old workbook",
    "json",
    "folder",
    "frame",
]

_MAGIC: tuple[tuple[bytes, Kind], ...] = (
    (b"PK\x03\x04", "zip"),
    (b"\x89HDF\r\n\x1a\n", "hdf5"),
    (b"PAR1", "parquet"),
    (b"\x93NUMPY", "array"),
    (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "old workbook"),
)
_ENDINGS = re.compile(
    r"(\.(csv|tsv|txt|xls|xlsx|xml|mat|h5|hdf5|parquet|npz|npy|slp|mdf|geff|zarr|gz))+$",
    re.IGNORECASE,
)
_WORKBOOK = b"xl/workbook.xml"
_MATLAB_HDF5 = 512
"""Bytes that MATLAB 7.3 puts in front of HDF5."""


STRICT = Reading(strict=True)
"""No bad row is left out."""


@runtime_checkable
class DataFrame(Protocol):
    """A table of pandas or polars."""

    @property
    def columns(self) -> Any:
        """Names of the columns."""

    def __getitem__(self, name: Any, /) -> Any:
        """The column of a name."""


@final
@dataclasses.dataclass(frozen=True)
class Source:
    """A file in memory, or a table that was in memory already.

    Attributes:
        content: bytes, decompressed where it was gzip; a DataFrame has none.
        reading: what the user states.
        faults: bad rows by their place; None where the first one is refused.
    """

    path: Path
    content: bytes
    frame: Mapping[str, np.ndarray] | None = None
    reading: Reading = STRICT
    faults: dict[str, str] | None = dataclasses.field(init=False, default=None)

    def __post_init__(self) -> None:
        if not self.reading.strict:
            object.__setattr__(self, "faults", {})

    @classmethod
    def read(
        cls, path: str | os.PathLike[str] | DataFrame, reading: Reading = STRICT
    ) -> "Source":
        """The file at `path`, decompressed where it is gzip, or a DataFrame."""
        if isinstance(path, DataFrame):
            columns = {str(name): np.asarray(path[name]) for name in path.columns}
            return cls(Path("DataFrame"), b"", columns, reading)
        path = Path(path)
        if path.is_dir():
            return cls(path, b"", None, reading)
        try:
            content = path.read_bytes()
            if content.startswith(b"\x1f\x8b"):
                content = gzip.decompress(content)
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            raise InputError(
                f"damaged gzip file: {error}; copy it from its origin again"
            ) from error
        except OSError as error:
            raise InputError(f"cannot read: {error.strerror or error}") from error
        if not content.strip(b"\0 \r\n\t"):
            raise InputError("the file is empty; copy it from its origin again")
        return cls(path, content, None, reading)

    @property
    def stem(self) -> str:
        """The name without its endings, such as `.csv.gz`."""
        return _ENDINGS.sub("", self.path.name)

    @cached_property
    def kind(self) -> Kind:
        """Kind of the file by its first bytes."""
        if self.frame is not None:
            return "frame"
        if self.path.is_dir():
            return "folder"
        if self.content.startswith(b"PK\x03\x04") and _WORKBOOK in self.content:
            return "workbook"
        for magic, kind in _MAGIC:
            if self.content.startswith(magic):
                return kind
        if self.content.startswith(b"MATLAB"):
            rest = self.content[_MATLAB_HDF5:]
            return "hdf5" if rest.startswith(b"\x89HDF") else "matlab"
        start = self.content[:200].lstrip(b"\xef\xbb\xbf \r\n\t")
        if start.startswith((b"{", b"[{", b"[[")):
            return "json"
        return "xml" if start.startswith(b"<") else "text"

    @cached_property
    def text(self) -> str:
        """The content as text."""
        wide = self.content.startswith((b"\xff\xfe", b"\xfe\xff"))
        try:
            text = self.content.decode("utf-16" if wide else "utf-8-sig")
        except UnicodeDecodeError as error:
            text = self._latin(error)
        if "\0" in text:
            line = text[: text.index("\0")].count("\n") + 1
            raise InputError(
                f"line {line}: expected text, got binary data; export it as CSV"
            )
        return text

    def _latin(self, error: UnicodeDecodeError) -> str:
        """Text of an older Windows program, where every odd byte is a sign of it."""
        text = self.content.decode("latin-1")
        odd = {c for c in text if ord(c) > 127}
        if odd <= set("µ°²³±×äöüÄÖÜßéèàçñ"):
            return text
        line = self.content[: error.start].count(b"\n") + 1
        raise InputError(
            f"line {line}: expected UTF-8 text, got the byte "
            f"0x{self.content[error.start]:02x}; save the file as UTF-8"
        ) from error

    @cached_property
    def first_lines(self) -> list[str]:
        """The first few lines of a text file, titles left out; none of another."""
        if self.kind != "text":
            return []
        return self.text[:20_000].splitlines()[self.skip :][:6]

    @cached_property
    def skip(self) -> int:
        """Rows above the header of a text file."""
        if self.reading.skip is not None:
            return self.reading.skip
        text = self.text[:20_000].splitlines()
        if text and text[0].startswith(layout.COMMENTS):
            return layout.rows_of_comments(text)
        spaced = not any(map(layout.delimiter_of, text))
        return layout.rows_above_header(
            [
                layout.cells_of(line) if spaced or layout.delimiter_of(line) else [line]
                for line in text
            ]
        )

    @cached_property
    def column_names(self) -> list[str]:
        """Names of the columns of a table, as far as they can be told cheaply."""
        if self.kind in ("frame", "parquet", "array"):
            return list(self.table().columns)
        if self.kind == "workbook" or not self.first_lines:
            return []
        names = layout.cells_of(layout.header_text(self.first_lines[0]))
        if all(map(layout.is_number, names)):
            return [str(index) for index in range(len(names))]
        return names

    def table(self) -> Table:
        """The table that a file or a DataFrame is."""
        if self.frame is not None:
            return self._count_rows(self.frame)
        if self.kind == "parquet":
            return self._count_rows(_parquet(self.content))
        if self.kind == "array":
            return self._count_rows(_array(self.content))
        if self.kind == "workbook":
            sheet, skip = self.reading.sheet, self.reading.skip
            return layout.sheet_table(self.content, sheet, skip, self.faults)
        if self.kind == "text":
            return self.read_text_table(skip=self.skip)
        raise InputError(
            f"expected a table as text, workbook, parquet or array, got {self.kind}; "
            "export it as CSV"
        )

    def read_text_table(
        self, *, skip: int = 0, below: int = 0, names: Sequence[str] | None = None
    ) -> Table:
        """The table of a text file; arguments as of `read_delimited`."""
        return layout.read_delimited(
            self.text, skip=skip, below=below, names=names, faults=self.faults
        )

    def _count_rows(self, columns: Mapping[str, Any]) -> Table:
        """A table whose rows are counted from 0, as DataFrames count them."""
        count = max(map(len, columns.values()), default=0)
        if count == 0:
            raise InputError(
                "the table has no rows; expected two or more of a particle"
            )
        return Table(dict(columns), np.arange(count), "row", faults=self.faults)


def _array(content: bytes) -> dict[str, np.ndarray]:
    """Columns of an array of NumPy: fields by their names, others by their numbers."""
    try:
        array = np.load(io.BytesIO(content), allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise InputError(
            f"damaged array: {str(error).partition('. ')[0]}; save it again with "
            "numpy.save, without objects"
        ) from error
    if array.dtype.names:
        return {name: array[name] for name in array.dtype.names}
    if array.ndim != 2:
        raise InputError(
            f"expected an array of rows and columns, got shape {array.shape}; save it "
            "with a column for each quantity"
        )
    return {str(index): column for index, column in enumerate(array.T)}


def _parquet(content: bytes) -> dict[str, list[Any]]:
    import pyarrow
    import pyarrow.parquet

    try:
        table = pyarrow.parquet.read_table(io.BytesIO(content))
    except (pyarrow.ArrowException, OSError) as error:
        reason = str(error).partition(".")[0]
        raise InputError(
            f"damaged parquet file: {reason}; copy it from its origin again"
        ) from error
    return {name: table.column(name).to_pylist() for name in table.column_names}


class AbstractFormat(abc.ABC):
    """A file format: how it is recognised, and how it is read."""

    name: str

    @abc.abstractmethod
    def suits(self, source: Source) -> bool:
        """True if the content looks like this format; cheap, and never raises."""

    @abc.abstractmethod
    def tracks(self, source: Source) -> Tracks:
        """The rows of the file."""
