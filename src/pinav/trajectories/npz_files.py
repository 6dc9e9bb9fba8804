"""Trajectories as arrays in a file, and what files say of them."""

import json
import math
import os
import zipfile
import zlib
from typing import Any, BinaryIO

import msgspec
import numpy as np

from pinav.errors import InputError
from pinav.trajectories.trajectories import Trajectories

FORMAT = 1
"""Version of both formats; a newer one is refused."""


class Metadata(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Metadata beside the numbers of a file; no provenance where it has none."""

    format: int = FORMAT
    channels: tuple[str, ...] = ()
    commands: tuple[str, ...] = ()
    units: dict[str, str] = {}
    provenance: dict[str, Any] | None = None


def metadata_text(trajectories: Trajectories) -> str:
    """The metadata of trajectories, as JSON."""
    metadata = Metadata(
        channels=trajectories.channels,
        commands=tuple(trajectories.commands),
        units=trajectories.units,
        provenance=trajectories.provenance,
    )
    return json.dumps(msgspec.structs.asdict(metadata))


def parse_metadata(place: str, text: str) -> Metadata:
    """Metadata from JSON."""
    try:
        values = json.loads(text)
        version = values.get("format", FORMAT) if isinstance(values, dict) else FORMAT
        if version != FORMAT:
            raise InputError(
                f"{place}: format {version!r} is not known, expected {FORMAT}; "
                "read it with the version of pinav that wrote it"
            )
        return msgspec.convert(values, Metadata)
    except (json.JSONDecodeError, msgspec.ValidationError) as error:
        raise InputError(f"{place}: not the metadata of pinav: {error}") from error


_ARRAYS = {"times": 1, "states": 2, "observed": 2, "commands": 2, "lengths": 1}
"""Arrays of the npz format and their axes; samples of all trajectories in one row."""


def write_npz(trajectories: Trajectories, file: BinaryIO) -> None:
    """Write trajectories as arrays."""
    pieces = list(trajectories)
    commands = [np.stack([*piece.commands.values(), piece.times]) for piece in pieces]
    np.savez(
        file,
        metadata=np.array(metadata_text(trajectories)),
        times=np.concatenate([piece.times for piece in pieces]),
        states=np.concatenate([piece.states for piece in pieces]),
        observed=np.concatenate([piece.observed for piece in pieces]),
        commands=np.concatenate(commands, axis=1)[:-1],
        lengths=trajectories.lengths,
    )


def read_npz(file: BinaryIO) -> Trajectories:
    """Read trajectories from arrays."""
    if not zipfile.is_zipfile(file):
        raise InputError("not an npz file, or one cut short; write it again")
    try:
        _check_sizes(file)
        file.seek(0)
        with np.load(file, allow_pickle=False) as archive:
            arrays = {name: np.asarray(archive[name]) for name in archive.files}
    except InputError:
        raise
    except (ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(f"damaged npz file: {error}") from error
    expected = ("metadata", *_ARRAYS)
    for name in expected:
        if name not in arrays:
            raise InputError(
                f"array {name!r} is missing; expected {', '.join(expected)}, "
                f"got {', '.join(arrays) or 'none'}"
            )
    metadata = parse_metadata("array 'metadata'", str(arrays["metadata"]))
    for name, ndim in _ARRAYS.items():
        if arrays[name].ndim != ndim:
            shape = arrays[name].shape
            raise InputError(f"array {name!r}: expected {ndim} axes, got shape {shape}")
    return _from_flat(arrays, metadata)


def is_foreign(path: str | os.PathLike[str]) -> bool:
    """True for an archive that holds none of our arrays."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except (OSError, zipfile.BadZipFile):
        return False
    return not {f"{name}.npy" for name in ("metadata", *_ARRAYS)} & set(names)


MAX_BYTES, MAX_RATIO = 2**33, 200
"""Size of an npz file's arrays, and how much larger than the file large ones may be."""


def _check_sizes(file: BinaryIO) -> None:
    """Refuse missing or oversized arrays before memory is allocated for them.

    A header may claim any number of values, and a few kilobytes may unpack to more than
    the memory holds.
    """
    file.seek(0)
    with zipfile.ZipFile(file) as archive:
        members = archive.infolist()
        total = sum(member.file_size for member in members)
        packed = sum(member.compress_size for member in members)
        if total > MAX_BYTES or (total > 2**27 and total > MAX_RATIO * packed):
            raise InputError(
                f"npz file of {packed} bytes that unpacks to {total}; expected the "
                "file of an experiment, at most 8 GiB"
            )
        for member in members:
            with archive.open(member) as stream:
                shape, dtype = read_header(stream)
                claimed = math.prod(shape) * dtype.itemsize
                if claimed > member.file_size:
                    raise InputError(
                        f"array {member.filename!r} claims {claimed} bytes, but the "
                        f"file holds {member.file_size}; write it again"
                    )


def read_header(stream: Any) -> tuple[tuple[int, ...], np.dtype]:
    """Shape and type of an array, as NumPy's format states them before its values."""
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0
    if version != (1, 0):
        read = np.lib.format.read_array_header_2_0
    shape, _, dtype = read(stream)
    return shape, dtype


def _from_flat(arrays: dict[str, np.ndarray], metadata: Metadata) -> Trajectories:
    lengths, count = arrays["lengths"], len(arrays["times"])
    if lengths.dtype.kind not in "iu" or (lengths < 0).any() or lengths.sum() != count:
        raise InputError(
            f"array 'lengths': expected whole numbers that add up to the {count} "
            f"times, got {lengths.tolist()}"
        )
    for name in ("states", "observed", "commands"):
        samples = arrays[name].shape[1 if name == "commands" else 0]
        if samples != count:
            raise InputError(f"array {name!r}: expected {count} samples, got {samples}")
    commands = arrays["commands"]
    if len(commands) != len(metadata.commands):
        raise InputError(
            f"array 'commands': expected {len(metadata.commands)} rows "
            f"({', '.join(metadata.commands)}), got {len(commands)}"
        )
    ends = np.cumsum(lengths)[:-1]
    return Trajectories.from_arrays(
        np.split(arrays["times"], ends),
        np.split(arrays["states"], ends),
        observed=np.split(arrays["observed"], ends),
        commands={
            name: np.split(values, ends)
            for name, values in zip(metadata.commands, commands, strict=True)
        },
        channels=metadata.channels,
        units=metadata.units,
        provenance=metadata.provenance,
    )
