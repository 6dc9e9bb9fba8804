"""What a worker of Dask does: it prepares its process, and attempts cells.

Dask imports this module by its name: when a worker of this machine starts, and where a
cell is handed to any other worker.
"""

import importlib
import os
import sys

from pinav.numerics import ONE_CORE, prepare_process
from pinav.sweeps.attempt import attempt

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
