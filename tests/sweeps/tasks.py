"""Cells for tests: quick ones without JAX, and some with faults."""

import ctypes
import time
from pathlib import Path

import msgspec

from pinav.errors import FitError
from pinav.sweeps import Cell


class Number(msgspec.Struct, frozen=True):
    """What a cell of the tests knows."""

    value: float
    mark: str = ""
    seconds: float = 0.0


def square(cell: Cell, folder: Path) -> None:
    """The square of a number, in two files; a mark tells who did it."""
    number = cell.read(Number)
    if number.mark:
        with open(number.mark, "a", encoding="utf-8") as file:
            file.write(f"{cell.label}\n")
    (folder / "first.txt").write_text("first")
    time.sleep(number.seconds)
    (folder / "square.txt").write_text(repr(number.value**2 + cell.seed))


def fail(cell: Cell, folder: Path) -> None:
    raise FitError("the fit is singular")


def stumble(cell: Cell, folder: Path) -> None:
    raise IndexError("no field")


def crash(cell: Cell, folder: Path) -> None:
    ctypes.string_at(0)


def hang(cell: Cell, folder: Path) -> None:
    (folder / "half.txt").write_text("half")
    time.sleep(60)


def fill(cell: Cell, folder: Path) -> None:
    with open("/dev/full", "w", encoding="utf-8") as file:
        file.write("too much")


def shout(cell: Cell, folder: Path) -> None:
    print("this is no answer")
    (folder / "square.txt").write_text("0")
