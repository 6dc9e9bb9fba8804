"""A session in one file, written beside and renamed: all of it, or the one before."""

import dataclasses
from pathlib import Path
from typing import Any, BinaryIO

import msgspec
import numpy as np

from pinav.codec import decode, encode
from pinav.errors import InputError
from pinav.files import atomic_write
from pinav.live.messages import Frame, Hello, Mode
from pinav.live.session import Counts, Session

SCHEMA = 3
"""Version of the file; another one is refused."""


class Header(msgspec.Struct, frozen=True, kw_only=True):
    """What of a session is no array.

    Attributes:
        schema: version of the file.
        hello: of the rig.
        mode: of the session.
        last: last frame.
        blind: frames in a row without a position.
        doubted: position that is doubted.
        counts: how often each thing happened.
    """

    schema: int
    hello: Hello | None
    mode: Mode
    last: Frame | None
    blind: int
    doubted: Frame | None
    counts: Counts


def write_session(path: Path, session: Session) -> None:
    """Write what a session knows, as an npz whose first member is the document.

    Raises:
        InputError: the system refused to write.
    """
    header = Header(
        schema=SCHEMA,
        hello=session.hello,
        mode=session.mode,
        last=session.last,
        blind=session.blind,
        doubted=session.doubted,
        counts=session.counts,
    )
    known = {"header": header, "estimator": session.estimator, "pilot": session.pilot}
    encoded = {name: encode(part) for name, part in known.items()}
    document = {name: part.document for name, part in encoded.items()}
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
    """What the session in a file knows, with the settings of another one.

    Args:
        path: of the file.
        session: a new one, with estimator and pilot of the same kinds.

    Raises:
        InputError: the file is missing, damaged, or of another version.
    """
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as kept:
            arrays = {name: kept[name] for name in kept.files}
        document = msgspec.json.decode(arrays.pop("document").tobytes())
        schema = document["header"]["schema"]
        if schema != SCHEMA:
            raise ValueError(f"version {schema}, expected {SCHEMA}")
        header = decode(Header, document["header"], {})
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
    return dataclasses.replace(
        session,
        estimator=estimator,
        pilot=pilot,
        hello=header.hello,
        mode=header.mode,
        last=header.last,
        blind=header.blind,
        doubted=header.doubted,
        counts=header.counts,
        resumed_at=None if header.last is None else header.last.seq,
    )


def with_drive_of(path: Path, session: Session) -> Session:
    """A new session that knows the drive of the robot from an earlier one.

    Where the robot is, and what happened to it, is not taken over.

    Args:
        path: of the earlier session's file.
        session: a new one, with an estimator of the same settings.

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
    """The document and the arrays of a part."""
    prefix = f"{name}/"
    part = {
        k.removeprefix(prefix): a for k, a in arrays.items() if k.startswith(prefix)
    }
    return document[name], part
