"""The benchmarks: `python -m benchmarks NAME`, in the folder of a source checkout."""

import importlib
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from pinav.cli import exit_code, main
from pinav.errors import InputError
from pinav.numerics import prepare_process

WITHOUT_FLAGS = ("heat",)
"""Benchmarks of commands without `Command.compiler_flags`."""


def names() -> list[str]:
    """The benchmarks: modules and packages with a `main`, by their names."""
    folder = Path(__file__).parent
    files = [*folder.glob("[a-z]*.py"), *folder.glob("[a-z]*/__init__.py")]
    modules = [
        path.stem if path.parent == folder else path.parent.name
        for path in files
        if "\ndef main(" in path.read_text(encoding="utf-8")
    ]
    return sorted(name.replace("_", "-") for name in modules)


def run(argv: Sequence[str], on_start: Callable[[], None] = lambda: None) -> int:
    """Run the benchmark of a name, which parses its own options and prints its table.

    Args:
        argv: The name, and the options of the benchmark.
        on_start: Called when all modules are imported and the run begins.

    Returns:
        The exit code of the process.
    """
    if not argv or argv[0] in ("-h", "--help"):
        print(f"usage: python -m benchmarks NAME [options]\n\n{', '.join(names())}")
        return 0
    # Benchmarks measure cold processes: nothing that was compiled before is used.
    prepare_process(flags=argv[0] not in WITHOUT_FLAGS, cache=False)
    return exit_code(lambda: _run(argv[0], argv[1:], on_start))


def _run(name: str, words: Sequence[str], on_start: Callable[[], None]) -> None:
    if name not in names():
        raise InputError(
            f"benchmark {name!r} is unknown; choose one of: {', '.join(names())}"
        )
    module = importlib.import_module(f"benchmarks.{name.replace('-', '_')}")
    on_start()
    module.main(words)


if __name__ == "__main__":
    main(sys.argv[1:], run)
