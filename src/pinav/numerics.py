"""What a process must set before numerical libraries are imported.

The command line and the workers of a sweep set the same, because how XLA compiles
decides the last digits of results.
"""

import contextlib
import ctypes
import gc
import os
import platform
import sys
from collections.abc import Mapping
from pathlib import Path

CACHE_BYTES = 256 * 2**20
"""Compiled code kept on disk; the oldest goes first."""

ONE_CORE = {"NPROC": "1", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
"""Variables of a worker. Sums that are shared by threads differ in their last digits
with the number of threads: on one, every machine and every engine gives the same bytes.
"""


def prepare_process(*, flags: bool = True, cache: bool = True) -> None:
    """Set what must stand before numerical libraries are imported and programs traced.

    Tracing makes many objects that live on: with Python's own thresholds the search for
    garbage among them takes a fifth of a fit.

    Args:
        flags: let XLA compile faster (`compiler_flags`).
        cache: keep compiled code on disk (`compilation_cache`).
    """
    from importlib import metadata  # slow to import, and not needed for help

    gc.set_threshold(50_000, 20, 100)
    # Two pools of threads on the same cores slow small factorisations tenfold.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if flags:
        os.environ.update(compiler_flags(os.environ, metadata.version("jaxlib")))
    if cache:
        os.environ.update(compilation_cache(os.environ))


def compiler_flags(environ: Mapping[str, str], jaxlib: str) -> dict[str, str]:
    """Variables that let XLA compile in two thirds of the time, for code as quick.

    Its older emitters of fused loops are meant. XLA ends a process whose flags it does
    not know, so that a version on which this was not tried is left alone, and so is a
    user's own choice.

    Args:
        jaxlib: version of jaxlib.
    """
    if "XLA_FLAGS" in environ or not jaxlib.startswith("0.10."):
        return {}
    return {"XLA_FLAGS": "--xla_cpu_use_fusion_emitters=false"}


def compilation_cache(environ: Mapping[str, str]) -> dict[str, str]:
    """Variables that let JAX keep on disk what it compiled; none where it may not.

    One folder for each machine: compiled code is for its processor. Set
    `JAX_COMPILATION_CACHE_DIR` for another place, or
    `JAX_ENABLE_COMPILATION_CACHE=false`.

    Args:
        environ: the environment; what it says of the cache is left to it.
    """
    if environ.get("JAX_ENABLE_COMPILATION_CACHE", "").lower() in ("false", "0"):
        return {}
    if "JAX_COMPILATION_CACHE_DIR" in environ:
        return {}
    base = environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    folder = os.path.join(base, "pinav", platform.node() or "machine")
    with contextlib.suppress(OSError):
        os.makedirs(folder, exist_ok=True)
    if not os.access(folder, os.W_OK):
        return {}
    return {
        "JAX_COMPILATION_CACHE_DIR": folder,
        "JAX_COMPILATION_CACHE_MAX_SIZE": str(CACHE_BYTES),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.05",
    }


MANY_REGIONS = 10_000
"""Regions of memory from which on compiled programs are let go: those of five fits,
which hold half a gigabyte. Linux allows a process 65 530, and XLA ends it when there
are no more."""


def free_programs(regions: Path = Path("/proc/self/maps")) -> bool:
    """Let compiled programs go where they hold many regions of memory.

    Some fifteen fits of different data would otherwise end a process. What is needed
    again is compiled again, or read from the cache on disk. Memory that is free goes
    back to the system, which the C library keeps otherwise.

    Args:
        regions: lists those of this process, one a line, where the system has it.

    Returns:
        Whether they were let go.
    """
    if "jax" not in sys.modules or not regions.exists():
        return False
    is_many = regions.read_bytes().count(b"\n") > MANY_REGIONS
    if is_many:
        import equinox
        import jax

        equinox.clear_caches()
        jax.clear_caches()
        gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # of the GNU library
    if trim is not None:
        trim(0)
    return is_many
