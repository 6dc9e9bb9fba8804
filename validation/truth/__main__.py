"""The program `python -m validation.truth`, in the folder of a source checkout."""

import sys
from collections.abc import Callable, Sequence

from validation.truth import TRUTH

from pinav.cli import exit_code, main
from pinav.numerics import prepare_process


def run(argv: Sequence[str], on_start: Callable[[], None] = lambda: None) -> int:
    """Judge the recordings of a folder; returns the exit code of the process.

    Args:
        argv: The folder, and options.
        on_start: Called when all modules are imported and the run begins.
    """
    prepare_process()
    from pinav.commands.dispatch import execute

    return exit_code(lambda: execute(TRUTH, argv, on_start))


if __name__ == "__main__":
    main(sys.argv[1:], run)
