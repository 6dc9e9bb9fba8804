"""The run folder: everything a run needs to be repeated, resumed and reported.

| file | holds |
|---|---|
| `config.toml` | all settings that decide the numbers |
| `environment.json` | versions and platform |
| `metrics.jsonl` | loss after each chunk, appended as it goes |
| `checkpoint-*.eqx` | state of a fit in progress |
| `model-*.eqx` | a fitted model: one JSON line, then its leaves |
| `data.npz`, `results.npz` | trajectories; arrays behind the figures |
| `metrics.json`, `*.csv` | result tables |
| `NAME.json`, `NAME.npz` | a result by `store`: its document, and its long arrays |
| `figures/`, `report.html` | what people look at |
| `manifest.json` | the files that the run wrote, with their hashes |

Files are written under a temporary name and renamed, so that none is ever half
written; nothing is pickled.
"""

import functools
import hashlib
import json
import platform
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np
import tomli_w

from pinav import __version__
from pinav.checkpoints import FileCheckpoint, Tree, read_tree, write_tree
from pinav.codec import decode, encode, kebab, members
from pinav.errors import InputError
from pinav.files import (
    append_line,
    atomic_write,
    csv_text,
    is_temporary,
    read_toml,
    write_text,
)
from pinav.manifest import MANIFEST_FILE, Manifest

Result = TypeVar("Result")

METRICS_FILE = "metrics.json"

LOCK_FILE = ".lock"
"""Held by the process that is at work on a run of many cells."""

SCHEMA = 3
"""Version of what a run folder holds; a run of another one is not read."""

FORMAT = 1
"""Version of the files of `store`; a result of another one is not read."""

FIRST_FILES = (
    *("config.toml", "environment.json", "system.toml", "system-code.json"),
    *("data.npz", "metrics.jsonl"),
)
"""Files that a run has before it has computed anything worth keeping."""

REPORTED_PACKAGES = ("jax", "jaxlib", "equinox", "diffrax", "optax", "numpy", "scipy")


class Stored(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The document of a result.

    Attributes:
        arrays: hash of the file with its long arrays; empty where it has none.
    """

    format: int
    kind: str
    value: Any
    arrays: str = ""


class RunFolder:
    """One run on disk."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def create(
        cls,
        path: Path,
        config: dict[str, Any],
        *,
        overwrite: bool,
        resumable: bool = True,
    ) -> "RunFolder":
        """Start a new run in an absent or empty folder.

        A run that ended before it had results worth keeping is replaced, too.

        Args:
            overwrite: replace the run that the folder holds.
            resumable: the command that makes the run can continue it.

        Raises:
            InputError: the folder holds another run and `overwrite` is false, holds
                something that is not a run, or cannot be made.
        """
        folder = cls(path)
        if path.exists() and not path.is_dir():
            raise InputError(f"{path} is a file; choose another folder with --out")
        if folder.exists():
            if not overwrite and folder._is_worth_keeping():
                finished = folder.has(METRICS_FILE) or not resumable
                advice = "" if finished else "continue it with --resume, "
                raise InputError(
                    f"{path} already holds a run; {advice}replace it with --overwrite, "
                    "or choose another folder with --out"
                )
            folder._remove_run()
        elif folder._holds_anything():
            raise InputError(
                f"{path} is not empty and holds no run; choose another --out"
            )
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(
                f"{path} cannot be made ({error.strerror}); choose another --out"
            ) from error
        folder.write_json("environment.json", environment())
        identity = {"schema": SCHEMA, **config.get("run", {})}
        folder.write_text("config.toml", tomli_w.dumps(config | {"run": identity}))
        return folder

    @classmethod
    def resume(cls, path: Path, config: dict[str, Any]) -> "RunFolder":
        """Continue a run, or start it where nothing was saved yet.

        Raises:
            InputError: the folder holds a run with other settings.
        """
        folder = cls(path)
        if not folder.exists():
            return cls.create(path, config, overwrite=False)
        folder._check_schema()
        saved, wanted = folder.config(), dict(config)
        saved |= saved.pop("run", {})
        wanted |= {"schema": SCHEMA, **wanted.pop("run", {})}
        for key in sorted(saved.keys() | wanted.keys()):
            if saved.get(key) == wanted.get(key):
                continue
            raise InputError(
                f"{path} holds a run with {key} = {saved.get(key)!r}, not "
                f"{wanted.get(key)!r}; resume with the settings in its config.toml, or "
                "choose another folder with --out"
            )
        folder._remove_temporary()
        folder.write_json("environment.json", environment())
        return folder

    @classmethod
    def open(cls, path: Path) -> "RunFolder":
        """An existing run.

        Raises:
            InputError: the folder does not hold a run.
        """
        folder = cls(path)
        if not folder.exists():
            raise InputError(
                f"{path} holds no run (no config.toml); give the folder that was the "
                "--out of pinav reproduce or pinav fit"
            )
        folder._check_schema()
        return folder

    def exists(self) -> bool:
        """Whether the folder holds a run."""
        return (self.path / "config.toml").is_file()

    def has(self, name: str) -> bool:
        """Whether the run has the file `name`."""
        return (self.path / name).is_file()

    def config(self) -> dict[str, Any]:
        """Settings of the run.

        Raises:
            InputError: `config.toml` is not readable TOML.
        """
        return read_toml(self.path / "config.toml")

    def _check_schema(self) -> None:
        schema = self.identity().get("schema")
        if schema != SCHEMA:
            raise InputError(
                f"{self.path} was written by another version of pinav (schema "
                f"{schema}, expected {SCHEMA}); repeat the run with --overwrite"
            )

    @property
    def manifest(self) -> Manifest:
        """The files that the run wrote; `--overwrite` deletes no others."""
        return Manifest(self.path)

    def identity(self) -> dict[str, Any]:
        """What tells the run from others beside its settings: command, data, system."""
        return self.config().get("run", {})

    @property
    def command(self) -> str:
        """Name of the command that made the run."""
        return self.identity().get("command", "")

    def write_text(self, name: str, text: str) -> None:
        """Write a text file."""
        write_text(self.path / name, text, overwrite=True)
        self.manifest.record(name)

    def write_json(self, name: str, content: Any) -> None:
        """Write a JSON file; a number that is not finite becomes null."""
        text = msgspec.json.format(_as_json(content), indent=2).decode()
        self.write_text(name, text + "\n")

    def read_json(self, name: str) -> Any:
        """Read a JSON file of the run."""
        path = self.path / name
        try:
            return json.loads(path.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
            raise InputError(
                f"{path} cannot be read ({error}); {self.manifest.repair(name)}"
            ) from error

    def store(self, name: str, result: Any) -> None:
        """Write a result: `NAME.npz` where it has long arrays, then `NAME.json`.

        The document holds the hash of the arrays, so that those of another result are
        not read with it, wherever a writer was killed.
        """
        document, arrays = encode(result)
        digest = ""
        if arrays:
            self.write_arrays(f"{name}.npz", arrays)
            digest = _hash(self.path / f"{name}.npz")
        elif f"{name}.npz" in self.manifest.entries():
            (self.path / f"{name}.npz").unlink(missing_ok=True)
            self.manifest.forget(f"{name}.npz")
        kind = kebab(type(result))
        self.write_json(f"{name}.json", Stored(FORMAT, kind, document, digest))

    def load(self, name: str, wanted: type[Result]) -> Result:
        """Read what `store` wrote, a value of a class or of a family of classes.

        Raises:
            InputError: a file is missing, damaged or of another result.
        """
        file = f"{name}.json"
        self.manifest.check(file)
        repair = self.manifest.repair(file)
        try:
            stored = msgspec.convert(self.read_json(file), Stored)
        except msgspec.ValidationError as error:
            raise InputError(
                f"{self.path / file} is damaged ({error}); {repair}"
            ) from error
        known = {kebab(wanted): wanted} | members(wanted)
        if stored.format != FORMAT or stored.kind not in known:
            raise InputError(
                f"{self.path / file} was written by another version of pinav; {repair}"
            )
        arrays = {}
        if stored.arrays:
            arrays = self.read_arrays(f"{name}.npz")
            if _hash(self.path / f"{name}.npz") != stored.arrays:
                raise InputError(
                    f"{self.path / name}.npz does not belong to {file}; {repair}"
                )
        try:
            return decode(known[stored.kind], stored.value, arrays)
        except InputError as error:
            raise InputError(
                f"{self.path / file} is damaged ({error}); {repair}"
            ) from error

    def write_table(
        self, name: str, header: Sequence[str], rows: Sequence[Sequence]
    ) -> None:
        """Write a CSV table, with empty cells for what is not defined."""
        self.write_text(name, csv_text([header, *rows]))

    def write_arrays(self, name: str, arrays: dict[str, np.ndarray]) -> None:
        """Write arrays as npz."""
        write = functools.partial(np.savez, **arrays)
        atomic_write(self.path / name, write, overwrite=True)
        self.manifest.record(name)

    def read_arrays(self, name: str) -> dict[str, np.ndarray]:
        """Read arrays written by `write_arrays`."""
        path = self.path / name
        try:
            # opened here, because NumPy leaves a damaged file open
            with open(path, "rb") as file, np.load(file, allow_pickle=False) as kept:
                return dict(kept)
        except Exception as error:
            raise InputError(
                f"{path} cannot be read ({error}); {self.manifest.repair(name)}"
            ) from error

    def append_record(self, record: dict[str, Any]) -> None:
        """Append a line to `metrics.jsonl`."""
        path = self.path / "metrics.jsonl"
        if not path.exists():
            self.manifest.record(path.name)
        append_line(path, _as_json(record))

    def write_model(self, name: str, header: dict[str, Any], model: Any) -> None:
        """Write a model: a JSON line that says how to build it, then its leaves."""
        line = json.dumps({"pinav": __version__, **header})
        write_tree(self.path / name, line, model)
        self.manifest.record(name)

    def read_model(self, name: str, build: Callable[[dict[str, Any]], Tree]) -> Tree:
        """Read a model; `build(header)` makes one of the same shape.

        Raises:
            InputError: the file is missing, damaged or of another run.
        """
        self.manifest.check(name)
        return read_tree(self.path / name, build, self.manifest.repair(name))

    def models(self) -> list[str]:
        """Names of the model files."""
        return sorted(path.name for path in self.path.glob("model*.eqx"))

    def checkpoint(self, name: str) -> "FileCheckpoint":
        """Where the fit `name` keeps its state."""
        file = f"checkpoint-{name}.eqx"
        self.manifest.record(file)
        return FileCheckpoint(self.path / file)

    def _holds_anything(self) -> bool:
        if not self.path.is_dir():
            return False
        names = {p.name for p in self.path.iterdir() if not is_temporary(p)}
        return bool(names - {"environment.json", MANIFEST_FILE, LOCK_FILE})

    def _is_worth_keeping(self) -> bool:
        """The run is finished, or holds a part that took time to compute."""
        return self.has(METRICS_FILE) or any(
            (self.path / name).is_file()
            for name in self.manifest.entries()
            if name not in FIRST_FILES
        )

    def _remove_run(self) -> None:
        """Remove the files that the run wrote, and nothing else; config.toml last."""
        names = [name for name in self.manifest.entries() if name != "config.toml"]
        for name in (*names, MANIFEST_FILE, "config.toml"):
            file = self.path / name
            if self.path.resolve() in file.resolve().parents:
                file.unlink(missing_ok=True)
        self._remove_temporary()

    def _remove_temporary(self) -> None:
        """Remove what a killed process left of a file that it was writing."""
        for folder in (self.path, self.path / "figures"):
            for file in folder.glob(".*.tmp"):
                if is_temporary(file):
                    file.unlink()


def _hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def environment() -> dict[str, Any]:
    """Versions and platform, for the record."""
    versions = {name: metadata.version(name) for name in REPORTED_PACKAGES}
    return {
        "pinav": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        **versions,
    }


def _as_json(content: Any) -> bytes:
    """The content in one line; a number that is not finite becomes null."""
    return msgspec.json.encode(content, enc_hook=_plain)


def _plain(value: Any) -> Any:
    """A builtin value for a number or an array of NumPy."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)
