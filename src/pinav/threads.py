"""Independent computations side by side, as threads of one process."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import jax

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
    function: Callable[[Item], Result], items: Sequence[Item]
) -> list[Result]:
    """The function of each item, in their order, as many at a time as there are cores.

    It pays where the function computes in LAPACK or XLA, which release Python's lock.
    Each result is that of a plain loop to the last bit.

    Args:
        function: must not change what other calls of it read.
        items: one call each.
    """
    exact = jax.config.read("jax_enable_x64")

    def compute(item: Item) -> Result:
        # Whether numbers are of double precision is a setting of each thread.
        with jax.enable_x64(exact):
            return function(item)

    threads = min(num_cores(), MOST_THREADS, len(items))
    if threads < 2:
        return [function(item) for item in items]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(compute, items))
