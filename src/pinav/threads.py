"""Independent computations side by side, as threads of one process."""

import contextlib
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import jax
from tqdm import tqdm

Item = TypeVar("Item")
Result = TypeVar("Result")

MOST_THREADS = 8
"""Threads at most: each holds matrices of its own."""


def num_cores() -> int:
    """Cores that this process may use; `NPROC` where that is set, as XLA has it."""
    given = os.environ.get("NPROC", "")
    if given.isdigit():
        return int(given)
    if hasattr(os, "sched_getaffinity"):  # Linux alone has it
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def map_on_cores(
    function: Callable[[Item], Result], items: Sequence[Item], *, title: str = ""
) -> list[Result]:
    """The function of each item, in their order, as many at a time as there are cores.

    It pays where the function computes in LAPACK or XLA, which release Python's lock.
    Each result is that of a plain loop to the last bit.

    Args:
        function: must not change what other calls of it read.
        items: one call each.
        title: of a progress bar; none unless given.
    """
    exact = jax.config.read("jax_enable_x64")

    def compute(item: Item) -> Result:
        # Whether numbers are of double precision is a setting of each thread.
        with jax.enable_x64(exact):
            return function(item)

    threads = min(num_cores(), MOST_THREADS, len(items))
    with contextlib.ExitStack() as stack:
        results = map(function, items)
        if threads > 1:
            pool = stack.enter_context(ThreadPoolExecutor(threads))
            results = pool.map(compute, items)
        return list(tqdm(results, title, len(items)) if title else results)
