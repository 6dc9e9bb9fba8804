"""The system of a fit: chosen on the command line, kept in the run."""

import hashlib
import re
from pathlib import Path

from pinav.errors import InputError
from pinav.runs import RunFolder
from pinav.scenarios import find_system, source_system
from pinav.systems import System, read_system, system_text
from pinav.trajectories import Trajectories

SYSTEM_FILE, CODE_FILE = "system.toml", "system-code.json"

_CODE = re.compile(r'"([^"\n]+\.py):\w+"')


def choose_system(text: str | None, data: Trajectories) -> System:
    """The system that the option names, or the one that the data come from.

    Args:
        text: of the option `--system`.
        data: trajectories, which may say what they were simulated from.

    Raises:
        InputError: no system is named and the data do not say where they come from.
    """
    if text is not None:
        return find_system(text)
    source = source_system(data.provenance)
    if source is None:
        raise InputError(
            "--system: the data do not say which system they come from; give a "
            "system file, or the name of a built-in one such as --system paper"
        )
    return source


def write_system_of(folder: RunFolder, system: System) -> None:
    """Keep the system of a run, and a hash of each Python file that it needs."""
    text = system_text(system)
    folder.write_text(SYSTEM_FILE, text)
    code = {path: _hash(path) for path in sorted(set(_CODE.findall(text)))}
    if code:
        folder.write_json(CODE_FILE, code)


def read_system_of(folder: RunFolder) -> System:
    """The system of a run.

    Raises:
        InputError: its file is damaged, or a Python file that it needs has changed.
    """
    code = folder.read_json(CODE_FILE) if folder.has(CODE_FILE) else {}
    for path, digest in code.items():
        if _hash(path) != digest:
            raise InputError(
                f"{path} has changed since {folder.path} was fitted; restore it, or "
                "fit again with --overwrite"
            )
    if not folder.has(SYSTEM_FILE):
        raise InputError(
            f"{folder.path} holds no {SYSTEM_FILE}, which says what was fitted; fit "
            "again with --overwrite"
        )
    return read_system(folder.path / SYSTEM_FILE)


def _hash(path: str) -> str:
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror}") from error
