"""`pinav bench`: run a benchmark of a source checkout."""

import importlib
import sys
from pathlib import Path

from pinav.commands.bench.settings import BenchOptions
from pinav.commands.command import CommandResult
from pinav.errors import InputError


def run(options: BenchOptions) -> CommandResult:
    """Run the benchmark, which parses its own options and prints its own table.

    Raises:
        InputError: there is no such benchmark.
    """
    root = Path(__file__).parents[4]
    entries = root.glob("benchmarks/[a-z]*")
    names = sorted(path.stem for path in entries if _is_module(path))
    if options.name not in names:
        known = (
            ", ".join(names) or "none here: benchmarks are part of a source checkout"
        )
        raise InputError(
            f"benchmark {options.name!r} is unknown; choose one of: {known}"
        )
    sys.path.insert(0, str(root))
    importlib.import_module(f"benchmarks.{options.name}").main(options.words)
    return CommandResult(None, "")


def _is_module(path: Path) -> bool:
    return path.suffix == ".py" or (path / "__init__.py").exists()
