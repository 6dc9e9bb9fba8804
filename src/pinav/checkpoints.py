"""Trees of arrays in files: a line of text, then the leaves; the state of a fit."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import equinox as eqx
import jax
import numpy as np

from pinav.arguments import on_device
from pinav.errors import InputError
from pinav.files import atomic_write
from pinav.fitting import AbstractCheckpoint, FitState

Tree = TypeVar("Tree")


class FileCheckpoint(AbstractCheckpoint):
    """A fit's state in one file: a JSON line, then its leaves."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def load(self, like: Callable[[int], FitState]) -> FitState | None:
        if not self.path.exists():
            return None

        def at_its_place(header: dict) -> FitState:
            starts = tuple(header["starts"])
            shape = like(len(starts) - 1)
            return dataclasses.replace(shape, starts=starts, taken=header["taken"])

        return read_tree(self.path, at_its_place)

    def save(self, state: FitState) -> None:
        header = json.dumps({"starts": state.starts, "taken": state.taken})
        write_tree(self.path, header, state)


def _read_leaf(file: BinaryIO, like: Any) -> Any:
    """A leaf from a file, without a program that is compiled for its shape."""
    if isinstance(like, jax.Array):
        return on_device(np.load(file))
    return eqx.default_deserialise_filter_spec(file, like)


def write_tree(path: Path, header: str, tree: Any) -> None:
    """Write one line of text and the leaves of a tree, atomically."""

    def write(file: BinaryIO) -> None:
        file.write(header.encode() + b"\n")
        eqx.tree_serialise_leaves(file, tree)

    atomic_write(path, write, overwrite=True)


def read_tree(
    path: Path,
    build: Callable[[dict[str, Any]], Tree],
    repair: str = "delete it and run again with --resume",
) -> Tree:
    """Read what `write_tree` wrote; `build(header)` gives a tree of the same shape.

    Args:
        build: gives a tree of the same shape from the header.
        repair: how the file is made again, for messages.

    Raises:
        InputError: the file is missing or damaged.
    """
    try:
        with open(path, "rb") as file:
            like = build(json.loads(file.readline()))
            return eqx.tree_deserialise_leaves(file, like, filter_spec=_read_leaf)
    except InputError:
        raise
    except Exception as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{path} cannot be read ({reason}); {repair}") from error
