"""Groups and arrays of Zarr in a folder, and of HDF5, as bare arrays."""

import dataclasses
import gzip
import io
import itertools
import json
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, final

import numpy as np

from pinav.errors import InputError

_BLOSC = {1: "lz4_raw", 2: "snappy", 3: "zlib", 4: "zstd"}
"""Compressors of Blosc by their number; 0, its own, is not read."""


@final
@dataclasses.dataclass(frozen=True)
class Group:
    """A folder of Zarr."""

    path: Path

    def attributes(self) -> Mapping[str, Any]:
        """The group's metadata; empty where it is no group."""
        if (self.path / "zarr.json").is_file():
            return _json(self.path / "zarr.json").get("attributes") or {}
        file = self.path / ".zattrs"
        return _json(file) if file.is_file() else {}

    def groups(self) -> list["Group"]:
        """The folders in it, by their names."""
        return [Group(p) for p in sorted(self.path.iterdir()) if p.is_dir()]

    def array(self, name: str) -> np.ndarray | None:
        """The array of a path such as `nodes/ids`; None where there is none."""
        folder = self.path / name
        for file, description in (("zarr.json", _third), (".zarray", _second)):
            if not (folder / file).is_file():
                continue
            said = _json(folder / file)
            try:
                return _array(folder, description(said))
            except InputError as error:
                raise InputError(f"{name}: {error}") from error
            except (ValueError, KeyError, TypeError, IndexError, zlib.error) as error:
                reason = str(error).partition("\n")[0]
                raise InputError(
                    f"{name}: damaged array of Zarr: {reason}; export it again"
                ) from error
            except OSError as error:
                raise InputError(
                    f"{name}: cannot read an array of Zarr: {error}; export it again"
                ) from error
        return None


@dataclasses.dataclass(frozen=True)
class _Stored:
    """Storage of an array: chunks of one shape, each through codecs in turn."""

    shape: Sequence[int]
    chunks: Sequence[int]
    dtype: np.dtype
    fill: Any
    order: str
    prefix: str
    separator: str
    codecs: Sequence[Mapping[str, Any]]


def _json(file: Path) -> Mapping[str, Any]:
    try:
        said = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(
            f"{file.name}: damaged Zarr: {error}; export it again"
        ) from error
    if not isinstance(said, dict):
        raise InputError(f"{file.name}: damaged Zarr: no entries; export it again")
    return said


def _second(said: Mapping[str, Any]) -> _Stored:
    if said.get("filters"):
        raise _unread("filters")
    codec = said.get("compressor")
    return _Stored(
        shape=said["shape"],
        chunks=said["chunks"],
        dtype=np.dtype(said["dtype"]),
        fill=said["fill_value"],
        order=said["order"],
        prefix="",
        separator=said.get("dimension_separator", "."),
        codecs=[{"name": codec["id"]}] if codec else [],
    )


def _third(said: Mapping[str, Any]) -> _Stored:
    keys, order = said["chunk_key_encoding"], "<"
    usual = keys["name"] == "default"
    default = "/" if usual else "."
    codecs = []
    for codec in said["codecs"]:
        if codec["name"] == "bytes":
            endian = (codec.get("configuration") or {}).get("endian", "little")
            order = ">" if endian == "big" else "<"
        else:
            codecs.append(codec)
    return _Stored(
        shape=said["shape"],
        chunks=said["chunk_grid"]["configuration"]["chunk_shape"],
        dtype=np.dtype(said["data_type"]).newbyteorder(order),
        fill=said["fill_value"],
        order="C",
        prefix="c" if usual else "",
        separator=(keys.get("configuration") or {}).get("separator", default),
        codecs=codecs,
    )


def _array(folder: Path, stored: _Stored) -> np.ndarray:
    if stored.dtype.kind not in "iufb":
        raise _unread(f"values of {stored.dtype}")
    fill = 0 if stored.fill is None else stored.fill
    whole = np.full(stored.shape, np.array(fill).astype(stored.dtype))
    sides = zip(stored.shape, stored.chunks, strict=True)
    for place in itertools.product(*(range(-(-side // one)) for side, one in sides)):
        names = [stored.prefix, *map(str, place)] if stored.prefix else map(str, place)
        file = folder / stored.separator.join(names)
        if not file.is_file():
            continue  # a chunk that holds nothing but the fill value is not stored
        count = int(np.prod(stored.chunks))
        content = file.read_bytes()
        for codec in reversed(stored.codecs):
            content = _plain(content, codec["name"], count * stored.dtype.itemsize)
        chunk = np.frombuffer(content, stored.dtype, count)
        chunk = chunk.reshape(stored.chunks, order="F" if stored.order == "F" else "C")
        corner = tuple(
            slice(i * one, min((i + 1) * one, side))
            for i, one, side in zip(place, stored.chunks, stored.shape, strict=True)
        )
        whole[corner] = chunk[tuple(slice(s.stop - s.start) for s in corner)]
    return whole


def _plain(content: bytes, codec: str, size: int) -> bytes:
    """The decompressed content of a codec."""
    if codec == "blosc":
        return _of_blosc(content)
    if codec == "crc32c":
        return content[:-4]
    if codec == "gzip":
        return gzip.decompress(content)
    if codec == "zlib":
        return zlib.decompress(content)
    if codec == "lz4":
        codec, content = "lz4_raw", content[4:]  # its size stands in front
    elif codec not in ("zstd", "lz4_raw", "snappy"):
        raise _unread(f"the codec {codec}")
    import pyarrow

    return pyarrow.Codec(codec).decompress(content, size, asbytes=True)


def _of_blosc(content: bytes) -> bytes:
    """Blocks of Blosc 1: bytes of each place together, in one stream or one a place."""
    flags, width = content[2], content[3]
    size, block, _ = np.frombuffer(content, "<u4", 3, 4).tolist()
    codec = _BLOSC.get(flags >> 5)
    if flags & 2:
        return content[16 : 16 + size]
    if codec is None or flags & 4:
        raise _unread("Blosc with its own compressor or with shuffled bits")
    starts = np.frombuffer(content, "<u4", -(-size // block), 16).tolist()
    blocks = []
    for number, at in enumerate(starts):
        length = min(block, size - number * block)
        split = not flags & 16 and length == block and 1 <= width <= 16
        streams = width if split and block // width >= 128 else 1
        part = b""
        for _ in range(streams):
            (packed,) = np.frombuffer(content, "<i4", 1, at).tolist()
            rest, whole = content[at + 4 : at + 4 + packed], length // streams
            part += rest if packed == whole else _plain(rest, codec, whole)
            at += 4 + packed
        blocks.append(_unshuffle(part, width) if flags & 1 else part)
    return b"".join(blocks)


def _unshuffle(block: bytes, width: int) -> bytes:
    """Values whose first bytes stand first, then all second ones, and so on."""
    count = len(block) // width
    places = np.frombuffer(block, np.uint8, count * width).reshape(width, count)
    return places.T.tobytes() + block[count * width :]


def _unread(what: str) -> InputError:
    return InputError(
        f"Zarr with {what} is not read; write the graph again with the codec zstd, or "
        "export its nodes as CSV and give --columns"
    )


@contextmanager
def open_group(content: bytes) -> Iterator[Any]:
    """The root group of an HDF5 file in memory."""
    import h5py

    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            yield file
    except InputError:
        raise
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        raise InputError(
            f"damaged HDF5 file: {error}; copy it from its origin again"
        ) from error
