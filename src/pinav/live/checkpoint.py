"""A session in one file, written beside and renamed: all of it, or the one before."""

import dataclasses
from pathlib import Path
from typing import BinaryIO

import msgspec
import numpy as np

from pinav.errors import InputError
from pinav.files import atomic_write
from pinav.live.messages import Frame, Hello, Mode
from pinav.live.session import Counts, Session

SCHEMA = 2
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
    """Write what a session knows.

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
    text = np.frombuffer(msgspec.json.encode(header), np.uint8)
    arrays = {f"estimator/{n}": a for n, a in session.estimator.to_arrays().items()}
    if session.pilot is not None:
        arrays |= {f"pilot/{n}": a for n, a in session.pilot.to_arrays().items()}

    def write(file: BinaryIO) -> None:
        np.savez(file, allow_pickle=False, header=text, **arrays)

    atomic_write(path, write, overwrite=True)


def read_session(path: Path, session: Session) -> Session:
    """What the session in a file knows, with the settings of another one.

    Args:
        path: of the file.
        session: a new one, with estimator and pilot of the same settings.

    Raises:
        InputError: the file is missing, damaged, or of another version.
    """
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as kept:
            arrays = {name: kept[name] for name in kept.files}
        header = msgspec.json.decode(arrays.pop("header").tobytes(), type=Header)
        if header.schema != SCHEMA:
            raise InputError(f"{path}: version {header.schema}, expected {SCHEMA}")
        pilot = session.pilot
        if pilot is not None and (part := _part(arrays, "pilot")):
            pilot = pilot.from_arrays(part)
        estimator = session.estimator.from_arrays(_part(arrays, "estimator"))
    except InputError:
        raise
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


def _part(arrays: dict[str, np.ndarray], name: str) -> dict[str, np.ndarray]:
    prefix = f"{name}/"
    return {
        key.removeprefix(prefix): array
        for key, array in arrays.items()
        if key.startswith(prefix)
    }
