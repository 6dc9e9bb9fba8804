"""What a worker of Dask does: it prepares its process, and attempts cells.

Dask imports this module by its name: when a worker of this machine starts, and where a
cell is handed to any other worker. Arguments and answer are text. An attempt leaves a
mark before it begins, so that the next one knows how many workers a cell has cost, and
whether it hung.
"""

import errno
import faulthandler
import importlib
import os
import platform
import shutil
import sys
import time
from pathlib import Path

import msgspec

from pinav import __version__
from pinav.errors import FitError, InputError
from pinav.numerics import ONE_CORE, free_programs, prepare_process
from pinav.sweeps.store import RESULT, TRACE_FILE, Cell, CellOutcome, CellStore

CRASHES = 3
"""Workers that a cell may crash before it counts as failed."""

KILLS = 20
"""Workers that may end without a word, as by a kill from outside, while they do a cell.

A cell that takes more memory than there is ends so, too. Twice as many would cost its
time twice; half of them fail cells where many workers are killed.
"""

REFUSALS_OF_THE_SYSTEM = (
    *(errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO),
    *(errno.EROFS, errno.EACCES, errno.EPERM),
)
"""Errors that are no cell's own: the sweep stops, and goes on when they are mended."""

SIGHT = 5.0
"""How long the folder of a sweep may take to be seen by a worker [s]."""


class Order(msgspec.Struct, frozen=True):
    """What a worker is told beside the cell.

    Attributes:
        token: of the sweep, which the worker must find in that folder.
        client: process and machine of the client.
        timeout: seconds after which the cell has failed; none for no limit.
    """

    cells: str
    token: str
    cell: str
    client: str
    timeout: float | None = None


def process_name() -> str:
    """This process among those of all machines."""
    return f"{platform.node()} {os.getpid()}"


def attempt(version: str, order: str) -> str:
    """Do a cell unless it is done, and say so.

    Args:
        version: of the client's program.
        order: an `Order` as JSON.

    Returns:
        Why nothing was done, or could be written; empty where the cell is done, and
        files say the rest.
    """
    if version != __version__:
        return (
            f"the client is pinav {version}, a worker on {platform.node()} pinav "
            f"{__version__}; install the same version on both"
        )
    try:
        _carry_out(msgspec.json.decode(order, type=Order))
    except InputError as error:
        return str(error)
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        return f"{place}{error.strerror or error}"
    return ""


def _carry_out(order: Order) -> None:
    store, cell = CellStore(Path(order.cells)), Cell.from_text(order.cell)
    if order.timeout is not None and order.client == process_name():
        raise InputError(
            "--cell-timeout: the workers are threads of this process, which cannot be "
            "stopped; choose workers that are processes"
        )
    _check_folder(store, order)
    if store.outcome(cell) is not None:
        return
    free_programs()
    before = store.attempts(cell.name)
    here, begin = store.begin(cell), time.monotonic()
    try:
        reason = _past_failure(before, order.timeout)
        again = bool(reason)
        reason = reason or _do(cell, here, order)
        seconds = round(time.monotonic() - begin, 3)
        store.publish(cell, here, CellOutcome(seconds, reason, again, __version__))
    except (OSError, InputError):
        shutil.rmtree(here, ignore_errors=True)
        raise
    for old in before:
        shutil.rmtree(old, ignore_errors=True)


def _check_folder(store: CellStore, order: Order) -> None:
    """Require that this machine sees the sweep's folder."""
    until = time.monotonic() + SIGHT  # a network's file system may show it late
    while True:
        plan = store.read_plan()
        if plan is not None and plan.token == order.token:
            return
        if time.monotonic() > until:
            raise InputError(
                f"a worker on {platform.node()} does not see {store.path}; choose "
                "--out on a file system that all machines share"
            )
        time.sleep(0.1)


def _past_failure(before: list[Path], timeout: float | None) -> str:
    """Why a cell is not tried again; empty where it is."""
    ends = [_last_words(folder) for folder in before]
    if any(words.startswith("Timeout") for words in ends):
        limit = "its time" if timeout is None else f"{timeout:g} s"
        return f"took longer than {limit}"
    crashes = sum(words.startswith("Fatal") for words in ends)
    if crashes >= CRASHES:
        return f"its worker died {crashes} times"
    if len(before) - crashes >= KILLS:
        return f"its worker was killed {len(before) - crashes} times"
    return ""


def _last_words(folder: Path) -> str:
    """What Python wrote of how an attempt ended; nothing after a kill from outside."""
    try:
        return (folder / TRACE_FILE).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def _do(cell: Cell, here: Path, order: Order) -> str:
    """Call the cell's function; the reason where it fails.

    A process that crashes, or whose time is over, writes where it was before it ends.
    """
    module, _, name = cell.command.partition(":")
    with open(here / TRACE_FILE, "w") as trace:
        if order.client != process_name():
            faulthandler.enable(trace)
        if order.timeout is not None:  # from a thread that needs no lock of Python's
            faulthandler.dump_traceback_later(order.timeout, exit=True, file=trace)
        try:
            getattr(importlib.import_module(module), name)(cell, here / RESULT)
        except (FitError, InputError) as error:
            if _is_of_the_system(error.__cause__):
                raise InputError(str(error)) from error
            return str(error)
        except Exception as error:  # a fault of one cell must not end the others
            if _is_of_the_system(error):
                raise
            return " ".join(f"{type(error).__name__}: {error}".split())[:300]
        finally:
            faulthandler.cancel_dump_traceback_later()
            if order.client != process_name():
                faulthandler.disable()
    return ""


def _is_of_the_system(error: BaseException | None) -> bool:
    return isinstance(error, OSError) and error.errno in REFUSALS_OF_THE_SYSTEM


SETTINGS = {"JAX_ENABLE_X64": "true", "TQDM_DISABLE": "1", **ONE_CORE}
"""Variables of the environment of a worker."""


def dask_setup(worker: object) -> None:
    """Prepare a worker of this machine, whose output is that of the command."""
    del worker
    os.dup2(2, 1)  # what a cell prints is no result of the command


def attempt_here(version: str, order: str) -> str:
    """`attempt` in a process that Dask started: prepared as that of a command is."""
    prepare_process()
    os.environ.update(SETTINGS)
    if "jax" in sys.modules:  # imported before, by someone else
        importlib.import_module("jax").config.update("jax_enable_x64", val=True)
    return attempt(version, order)
