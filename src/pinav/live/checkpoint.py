"""A session in one file, written beside and renamed: all of it, or the one before."""

import dataclasses
from pathlib import Path
from typing import Any, BinaryIO, get_type_hints

import msgspec
import numpy as np

from pinav.codec import decode, encode
from pinav.errors import InputError
from pinav.files import atomic_write
from pinav.live.session import Session

SCHEMA = 4
"""Version of the file; another one is refused."""


KEPT = ("hello", "mode", "last", "blind", "doubted", "counts")
"""Fields of a session that are kept, beside estimator and pilot."""


def write_session(path: Path, session: Session) -> None:
    """Write what a session knows, as an npz whose first member is the document.

    Raises:
        InputError: the system refused to write.
    """
    parts = ("estimator", "pilot", *KEPT)
    encoded = {name: encode(getattr(session, name)) for name in parts}
    document = {name: part.document for name, part in encoded.items()}
    document["schema"] = SCHEMA
    text = np.frombuffer(msgspec.json.encode(document), np.uint8)
    arrays = {
        f"{name}/{place}": array
        for name, part in encoded.items()
        for place, array in part.arrays.items()
    }

    def write(file: BinaryIO) -> None:
        np.savez(file, allow_pickle=False, document=text, **arrays)

    atomic_write(path, write, overwrite=True)


def read_session(path: Path, session: Session) -> Session:
    """The session in a file, with the settings of another one.

    Raises:
        InputError: the file is missing, damaged, or of another version.
    """
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        document = msgspec.json.decode(arrays.pop("document").tobytes())
        schema = document.get("schema")
        if schema != SCHEMA:
            raise ValueError(f"version {schema}, expected {SCHEMA}")
        kinds = get_type_hints(Session)
        kept = {name: decode(kinds[name], document[name], {}) for name in KEPT}
        estimator = decode(
            type(session.estimator), *_part(document, arrays, "estimator")
        )
        pilot = session.pilot
        if pilot is not None and document["pilot"] is not None:
            earlier = decode(type(pilot), *_part(document, arrays, "pilot"))
            pilot = pilot.resume(earlier)
    except Exception as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(
            f"{path} cannot be read ({reason}); begin without it"
        ) from error
    resumed_at = None if kept["last"] is None else kept["last"].seq
    known = {**kept, "estimator": estimator, "pilot": pilot}
    return dataclasses.replace(session, resumed_at=resumed_at, **known)


def with_drive_of(path: Path, session: Session) -> Session:
    """A new session that knows the drive of the robot from an earlier one.

    Where the robot is, and what happened to it, is not taken over.

    Raises:
        InputError: the file is missing, damaged, or of another version; no drive had
            been seen.
    """
    earlier = read_session(path, session)
    if earlier.hello is None or not earlier.estimator.driven:
        raise InputError(
            f"{path}: the session had not seen the robot driven, so that nothing is "
            "known; begin without --prior"
        )
    return dataclasses.replace(
        session, estimator=earlier.estimator, known_in=earlier.hello.units
    )


def _part(
    document: dict[str, Any], arrays: dict[str, np.ndarray], name: str
) -> tuple[Any, dict[str, np.ndarray]]:
    prefix = f"{name}/"
    part = {
        k.removeprefix(prefix): a for k, a in arrays.items() if k.startswith(prefix)
    }
    return document[name], part
