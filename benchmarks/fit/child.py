"""The process of one contestant: `python -m benchmarks.fit.child NAME ...`.

It trains, writes what was learned, and prints one line of JSON.
"""

import importlib
import re
import resource
import sys
import time
from pathlib import Path

import msgspec
import numpy as np

from benchmarks.fit.contestants import BY_NAME, Effort
from benchmarks.fit.problem import Problem
from benchmarks.fit.table import Measured


def main(launched: str, name: str, seed: str, data: str, result: str, effort: str):
    module, function = BY_NAME[name].train.split(":")
    problem = Problem.read(Path(data), float(launched))
    train = getattr(importlib.import_module(f"benchmarks.fit.{module}"), function)
    start = time.perf_counter()
    trained = train(problem, int(seed), msgspec.json.decode(effort, type=Effort))
    seconds = time.perf_counter() - start
    np.savez(result, curve=trained.curve, **trained.arrays)
    measured = Measured(
        iterations=trained.iterations,
        fit_seconds=seconds,
        full_seconds=trained.full_seconds,
        peak_mib=peak_memory(),
        note=trained.note,
    )
    print(msgspec.json.encode(measured).decode())


def peak_memory() -> float:
    """Peak resident memory of this process [MiB].

    `getrusage` would count the parent too: Linux carries the peak over a fork and exec.
    """
    status = Path("/proc/self/status")
    if status.exists():
        found = re.search(r"VmHWM:\s+(\d+) kB", status.read_text(encoding="ascii"))
        if found:
            return int(found[1]) / 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1024**2 if sys.platform == "darwin" else peak / 1024


if __name__ == "__main__":
    main(*sys.argv[1:])
