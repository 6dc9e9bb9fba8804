"""One piece of work as text, and what became of it."""

import hashlib
import re
import tomllib
from typing import Any, TypeVar

import msgspec
import tomli_w

Settings = TypeVar("Settings", bound=msgspec.Struct)

HASH_DIGITS = 12
"""Digits of the hash in the name of a cell."""


class Cell(msgspec.Struct, frozen=True):
    """One piece of work; all that decides its result is in four of its fields.

    Attributes:
        command: "module:name" of the function that does it, which takes the cell and
            the folder that its files go to.
        system: name of the system, or the path of the data.
        settings: everything else that decides the result, as TOML.
        seed: of what is random.
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
            settings: a struct of numbers, words and sequences of them.
            system: name of the system, or the path of the data.
            others: the fields `seed`, `label` and `shape`.
        """
        content = msgspec.to_builtins(settings)
        plain = {name: value for name, value in content.items() if value is not None}
        return cls(command, system, tomli_w.dumps(plain), **others)

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


class Outcome(msgspec.Struct, frozen=True):
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
