"""Values that a user's own Python file defines, named `file.py:name`."""

import importlib.util
import sys
import traceback
from pathlib import Path
from types import ModuleType
from typing import Any

from pinav.errors import InputError

ORIGIN = "pinav_own_"
"""Begins the names of the modules that are loaded here."""


def load_name(key: str, reference: str, folder: Path | None) -> Any:
    """The value `file.py:name`, for which the file is run; `key` is for messages.

    Args:
        folder: base of relative file names; None refuses to run the file.
    """
    if folder is None:
        raise InputError(
            f"{key}: {reference!r} names Python code, which is not run from a data "
            "file; give the system by --system"
        )
    place, _, name = reference.rpartition(":")
    module = _load((folder / Path(place).expanduser()).resolve())
    if not hasattr(module, name):
        names = [n for n in vars(module) if not n.startswith("_")]
        raise InputError(
            f"{place}: defines no {name!r}; choose one of {', '.join(names) or 'none'}"
        )
    return getattr(module, name)


def python_reference(key: str, cls: type) -> str:
    """Reference by which a file names a class of a user's own."""
    module = sys.modules.get(cls.__module__)
    if module is None or not cls.__module__.startswith(ORIGIN):
        raise InputError(
            f"{key}: {cls.__name__} of the module {cls.__module__} cannot be named "
            "in a file; put the class into a file and name the system file.py:name"
        )
    return f"{module.__file__}:{cls.__qualname__}"


def _load(path: Path) -> ModuleType:
    name = ORIGIN + path.as_posix().replace(".", "_")
    if name in sys.modules:
        return sys.modules[name]
    if not path.is_file():
        raise InputError(
            f"{path}: there is no such file; name a Python file as it lies"
        )
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise InputError(f"{path}: {_failure(path, error)}") from error
    return module


def _failure(path: Path, error: BaseException) -> str:
    """The error of a user's code in one line, with the line of the file."""
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if frame.filename == str(path)]
    if isinstance(error, SyntaxError):
        lines = [error.lineno]
    where = f"line {lines[-1]}: " if lines else ""
    return f"{where}{type(error).__name__}: {' '.join(str(error).split())}; correct it"
