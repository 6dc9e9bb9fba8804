"""The manifest of a run: the files that it wrote, with their hashes."""

import contextvars
import dataclasses
import hashlib
import json
from pathlib import Path

import msgspec

from pinav.errors import InputError
from pinav.files import UNREADABLE, write_text

MANIFEST_FILE = "manifest.json"

REPAIR: contextvars.ContextVar[str] = contextvars.ContextVar("repair", default="")
"""How the files that are written now are made again; the command line says so."""


class Entry(msgspec.Struct, frozen=True):
    """A file that a run wrote.

    Attributes:
        repair: how it is made again.
        hash: of its content; empty where it changes while the run goes on.
    """

    repair: str = ""
    hash: str = ""


@dataclasses.dataclass(frozen=True)
class Manifest:
    """What a run wrote; `--overwrite` deletes nothing else."""

    folder: Path

    def entries(self) -> dict[str, Entry]:
        """Every file by its name; none where the manifest is missing or damaged."""
        try:
            content = (self.folder / MANIFEST_FILE).read_bytes()
            return msgspec.json.decode(content, type=dict[str, Entry])
        except UNREADABLE:
            return {}

    def record(self, *names: str) -> None:
        """Note that the run wrote these files."""
        made = {name: Entry(REPAIR.get(), self._hash(name)) for name in names}
        self._write(self.entries() | made)

    def forget(self, name: str) -> None:
        """Note that the run has removed a file."""
        self._write({n: e for n, e in self.entries().items() if n != name})

    def _write(self, entries: dict[str, Entry]) -> None:
        text = json.dumps(msgspec.to_builtins(entries), indent=1)
        write_text(self.folder / MANIFEST_FILE, text, overwrite=True)

    def check(self, name: str) -> None:
        """Require that a file is the one that the run wrote.

        Raises:
            InputError: it is missing, damaged, or taken from another run.
        """
        path = self.folder / name
        if not path.is_file():
            raise InputError(f"{path} is missing; {self.repair(name)}")
        entry = self.entries().get(name, Entry())
        if entry.hash not in ("", self._hash(name)):
            raise InputError(
                f"{path} is not the file that this run wrote; {self.repair(name)}"
            )

    def repair(self, name: str) -> str:
        """The words that say how a damaged or missing file is made again."""
        entry = self.entries().get(name, Entry())
        return entry.repair or "repeat the run with --overwrite"

    def _hash(self, name: str) -> str:
        """Hash of a file that does not change any more; empty for others."""
        path = self.folder / name
        if name.startswith(("checkpoint-", "metrics.jsonl")) or not path.is_file():
            return ""
        return hashlib.sha256(path.read_bytes()).hexdigest()[:16]
