"""Benchmark: fields of many families, with and without a search for their structure."""

from collections.abc import Sequence


def main(argv: Sequence[str]) -> None:
    """Run the benchmark with these options."""
    from benchmarks.fields.table import main

    main(argv)
