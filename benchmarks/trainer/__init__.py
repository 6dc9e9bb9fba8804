"""Benchmark: the default recipe and the paper's on sixty systems drawn by key."""

from collections.abc import Sequence


def main(argv: Sequence[str]) -> None:
    """Run the benchmark with these options."""
    from benchmarks.trainer.table import main

    main(argv)
