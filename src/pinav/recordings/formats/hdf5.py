"""HDF5 read as bare arrays: no object in a file is ever built."""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from pinav.errors import InputError


@contextmanager
def open_group(content: bytes) -> Iterator[Any]:
    """The root group of an HDF5 file in memory.

    Raises:
        InputError: the file is damaged, also where that shows while it is read.
    """
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
