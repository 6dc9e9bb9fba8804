"""The result of each command can be stored: its annotations name what files hold."""

import enum
import subprocess
import sys
import typing
from collections.abc import Iterator, Mapping
from typing import Any

import msgspec
import numpy as np
import pytest

from pinav import codec
from pinav.commands import COMMANDS
from pinav.commands.command import resolve

STORED = {command.name: command for command in COMMANDS if command.result}
"""Commands whose result is a value of the library."""

PLAIN = (bool, int, float, str, enum.Enum, msgspec.Struct)
"""Classes whose values stand in a document as they are."""


def obstacles(wanted: Any, path: str, above: tuple[type, ...] = ()) -> Iterator[str]:
    """Each field below an annotation that no file can hold, and why."""
    if wanted is Any:
        yield f"{path}: anything"
        return
    try:
        wanted = codec._of_option(wanted)
    except TypeError as error:
        yield f"{path}: {error}"
        return
    origin = typing.get_origin(wanted)
    if hasattr(wanted, "dim_str") or wanted is np.ndarray:
        return
    if origin in (tuple, list, dict, Mapping):
        for part in typing.get_args(wanted):
            if part is not Ellipsis:
                yield from obstacles(part, f"{path}[]", above)
    elif not isinstance(wanted, type):
        yield f"{path}: {wanted}"
    elif not issubclass(wanted, PLAIN) and wanted not in above:
        yield from _record_obstacles(wanted, path, (*above, wanted))


def _record_obstacles(cls: type, path: str, above: tuple[type, ...]) -> Iterator[str]:
    if codec._is_record(cls):
        for name, hint in codec._hints(cls).items():
            yield from obstacles(hint, f"{path}.{name}", above)
    elif not codec.members(cls):
        yield f"{path}: {cls.__name__}, which is no record"


@pytest.mark.parametrize("name", STORED)
def test_the_result_of_a_command_can_be_stored(name):
    result = resolve(STORED[name].result)
    assert not list(obstacles(result, result.__name__))


@pytest.mark.parametrize("name", STORED)
def test_a_stored_result_has_a_file_and_is_said(name):
    command = STORED[name]
    assert command.file
    assert callable(resolve(command.sections))


IMPORT_ALL = """
import pkgutil, pinav
from pinav.codec import members
from pinav.commands import COMMANDS
from pinav.commands.command import resolve
said = [c for c in COMMANDS if c.result and resolve(c.sections)]
wanted = {c.name: resolve(c.result) for c in said}
known = {name: members(family) for name, family in wanted.items()}
for module in pkgutil.walk_packages(pinav.thermal.__path__, "pinav.thermal."):
    __import__(module.name)
assert known == {name: members(family) for name, family in wanted.items()}
"""
"""Heat alone has results in several modules; `heat learn` could not be reported."""


def test_who_says_a_result_knows_all_classes_that_it_may_have():
    subprocess.run([sys.executable, "-c", IMPORT_ALL], check=True)


def test_what_cannot_be_stored_is_found():
    class Bad(typing.NamedTuple):
        function: typing.Callable
        anything: Any
        either: int | str

    assert len(list(obstacles(Bad, "Bad"))) == 3
