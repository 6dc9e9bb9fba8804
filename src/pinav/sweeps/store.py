"""Cells: pieces of work as text, and their folders, whole or absent.

```text
cells/sweep.json                    the table of cells, and who works on it
cells/NAME-HASH/cell.toml           a cell that is done: the text that it was made of,
cells/NAME-HASH/outcome.json        what became of it,
cells/NAME-HASH/...                 and the files of its result
cells/.NAME-HASH.12345678.tmp/      an attempt in progress, or one that died
```
"""

import contextlib
import hashlib
import os
import platform
import re
import secrets
import shutil
import time
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import filelock
import msgspec
import tomli_w

from pinav import __version__
from pinav.errors import InputError
from pinav.files import UNREADABLE, write_whole

Settings = TypeVar("Settings", bound=msgspec.Struct)

HASH_DIGITS = 12
"""Digits of the hash in the name of a cell."""


class Cell(msgspec.Struct, frozen=True):
    """One piece of work; all that decides its result is in four of its fields.

    Attributes:
        system: name of the system, or the path of the data.
        settings: everything else that decides the result, as TOML.
        label: what people call it; does not count for the hash.
        shape: cells of one shape share compiled programs; does not count either.
    """

    command: str
    system: str
    settings: str
    seed: int = 0
    label: str = ""
    shape: str = ""

    @classmethod
    def of(
        cls, command: str, settings: msgspec.Struct, *, system: str, **others: Any
    ) -> "Cell":
        """The cell with these settings.

        Args:
            command: "module:name".
            settings: a struct of numbers, words, and sequences and structs of them.
            others: the fields `seed`, `label` and `shape`.
        """
        content = without_none(msgspec.to_builtins(settings, enc_hook=str))
        return cls(command, system, tomli_w.dumps(content), **others)

    @classmethod
    def from_text(cls, text: str) -> "Cell":
        """The cell that `text` was made of.

        Raises:
            msgspec.ValidationError: it is no cell.
        """
        return msgspec.convert(tomllib.loads(text), cls)

    @property
    def text(self) -> str:
        """The cell as TOML: what travels to a worker."""
        return tomli_w.dumps(msgspec.to_builtins(self))

    def read(self, kind: type[Settings]) -> Settings:
        """The settings that the cell was made of."""
        return msgspec.convert(tomllib.loads(self.settings), kind)

    @property
    def hash(self) -> str:
        """SHA-256 of what decides the result."""
        content = (self.command, self.system, self.settings, str(self.seed))
        return hashlib.sha256("\0".join(content).encode()).hexdigest()

    @property
    def name(self) -> str:
        """Name of the folder of its result: words for people, then the hash."""
        words = re.sub(r"[^a-zA-Z0-9.]+", "-", self.label).strip("-.")[:60]
        return f"{words or 'cell'}-{self.hash[:HASH_DIGITS]}"


def without_none(content: Any) -> Any:
    """The content without entries that TOML cannot hold."""
    if not isinstance(content, dict):
        return content
    return {k: without_none(v) for k, v in content.items() if v is not None}


class CellOutcome(msgspec.Struct, frozen=True):
    """What became of a cell.

    Attributes:
        seconds: that it took.
        failure: why it failed; empty where it has a result.
        again: the failure is one of the machine, so that a resumed sweep tries again.
        version: of the program that did it.
    """

    seconds: float
    failure: str = ""
    again: bool = False
    version: str = ""


Result = TypeVar("Result")

FOLDER, SWEEP_FILE, LOCK_FILE = "cells", "sweep.json", ".lock"
CELL_FILE, OUTCOME_FILE = "cell.toml", "outcome.json"
START_FILE, TRACE_FILE, RESULT = "started.json", "trace.txt", "result"

PATIENCE = 10.0
"""How long a file of another machine may take to be seen here [s]."""


class Start(msgspec.Struct, frozen=True):
    """Who began an attempt, and when.

    Attributes:
        since: seconds since the epoch, by the clock of that machine.
    """

    host: str
    pid: int
    since: float


class Plan(msgspec.Struct, frozen=True):
    """The table of cells of a sweep, as its file holds it.

    Attributes:
        token: tells this sweep from others in a folder of the same name.
        version: of the client's program.
        cells: name and label of each cell, in the order of the table.
    """

    token: str
    version: str
    engine: str
    cells: dict[str, str]


class CellStore:
    """The cells of one run on disk."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def of_run(cls, run: Path) -> "CellStore":
        """The cells in the folder of a run."""
        return cls(run / FOLDER)

    def folder(self, cell: Cell) -> Path:
        """Where the files of a finished cell are."""
        return self.path / cell.name

    def outcome(self, cell: Cell) -> CellOutcome | None:
        """What became of a cell; none where it is not done."""
        return self.outcome_of(cell.name)

    def outcome_of(self, name: str) -> CellOutcome | None:
        """What became of the cell of that name; none where it is not done."""
        folder = self.path / name
        if not folder.exists():
            return None
        if not (folder / OUTCOME_FILE).exists():
            raise InputError(
                f"{folder} is damaged; delete it and continue with --resume"
            )
        return _read(folder / OUTCOME_FILE, CellOutcome, f"delete {folder}")

    def wait_for(self, cell: Cell) -> CellOutcome | None:
        """The outcome of a cell that a worker says is done.

        A network's file system may show what another machine wrote seconds later;
        reading the folder above makes it look.
        """
        until = time.monotonic() + PATIENCE
        while (outcome := self.outcome(cell)) is None and time.monotonic() < until:
            os.listdir(self.path)
            time.sleep(0.1)
        return outcome

    def write_plan(self, cells: Iterable[Cell], engine: str) -> Plan:
        """Write the table of cells, from which workers know the folder."""
        names = {cell.name: cell.label for cell in cells}
        plan = Plan(secrets.token_hex(8), __version__, engine, names)
        self.path.mkdir(parents=True, exist_ok=True)
        write_whole(
            self.path / SWEEP_FILE, lambda file: file.write(msgspec.json.encode(plan))
        )
        return plan

    def read_plan(self) -> Plan | None:
        """The table of cells; none where there is none."""
        file = self.path / SWEEP_FILE
        return _read(file, Plan, "delete it") if file.exists() else None

    def begin(self, cell: Cell) -> Path:
        """A folder for an attempt; `publish` makes its part `result` the cell's."""
        attempt = self.path / f".{cell.name}.{secrets.token_hex(4)}.tmp"
        (attempt / RESULT).mkdir(parents=True)
        start = Start(platform.node(), os.getpid(), time.time())
        (attempt / START_FILE).write_bytes(msgspec.json.encode(start))
        return attempt

    def publish(self, cell: Cell, attempt: Path, outcome: CellOutcome) -> None:
        """Make the files of an attempt those of the cell, all at once.

        Where another attempt was first, its files stay, and these are dropped.
        """
        result = attempt / RESULT
        write_whole(result / CELL_FILE, lambda file: file.write(cell.text.encode()))
        write_whole(
            result / OUTCOME_FILE, lambda file: file.write(msgspec.json.encode(outcome))
        )
        try:
            os.rename(result, self.folder(cell))
        except OSError:
            if self.outcome(cell) is None:
                raise
        shutil.rmtree(attempt, ignore_errors=True)

    def attempts(self, name: str) -> list[Path]:
        """Attempts at a cell that are in progress, or died."""
        digits = "[0-9a-f]" * 8
        return sorted(self.path.glob(f".{name}.{digits}.tmp"))

    def start_of(self, attempt: Path) -> Start | None:
        """Who began an attempt; none where that was not written down in time."""
        try:
            content = (attempt / START_FILE).read_bytes()
            return msgspec.json.decode(content, type=Start)
        except UNREADABLE:
            return None

    def forget(self, cell: Cell) -> None:
        """Drop the attempts at a cell."""
        for attempt in self.attempts(cell.name):
            shutil.rmtree(attempt, ignore_errors=True)

    def discard(self, cell: Cell) -> None:
        """Delete what became of a cell, so that it is done again."""
        shutil.rmtree(self.folder(cell), ignore_errors=True)

    def remove(self) -> None:
        """Delete every cell, known by the text that it was made of, and no other."""
        for file in self.path.glob(f"*/{CELL_FILE}"):
            with contextlib.suppress(OSError, ValueError, msgspec.ValidationError):
                cell = Cell.from_text(file.read_text(encoding="utf-8"))
                if file.parent.name == cell.name:
                    self.forget(cell)
                    self.discard(cell)
        (self.path / SWEEP_FILE).unlink(missing_ok=True)


def _read(file: Path, kind: type[Result], remedy: str) -> Result:
    """The content of a file as JSON."""
    try:
        return msgspec.json.decode(file.read_bytes(), type=kind)
    except UNREADABLE as error:
        raise InputError(
            f"{file} cannot be read ({error}); {remedy} and continue with --resume"
        ) from error


@contextlib.contextmanager
def claim(run: Path) -> Iterator[None]:
    """Hold the folder of a run for this client alone; a killed one holds nothing.

    Raises:
        InputError: another client is at work on it, or it cannot be made.
    """
    existed = run.is_dir()
    try:
        run.mkdir(parents=True, exist_ok=True)
        lock = filelock.FileLock(run / LOCK_FILE, timeout=0)
        lock.acquire()
    except filelock.Timeout as error:
        raise InputError(
            f"{run}: another process is at work on this folder; wait for it, or choose "
            "another folder with --out"
        ) from error
    except OSError as error:
        raise InputError(
            f"{run} cannot be written ({error.strerror or error}); choose another "
            "folder with --out"
        ) from error
    try:
        yield
    finally:
        if not existed and [file.name for file in run.iterdir()] == [LOCK_FILE]:
            (run / LOCK_FILE).unlink()
            run.rmdir()
        lock.release()


def is_claimed(run: Path) -> bool:
    """Whether a client is at work on the folder of a run."""
    if not (run / LOCK_FILE).exists():
        return False
    lock = filelock.FileLock(run / LOCK_FILE, timeout=0)
    try:
        lock.acquire()
    except (filelock.Timeout, OSError):
        return True
    lock.release()
    return False
