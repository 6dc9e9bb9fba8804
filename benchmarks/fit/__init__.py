"""One table of fits: the paper's recipe, other tools, and ours, on the same data.

Run with `python -m benchmarks fit`. Every contestant trains in a process of its own,
one after the other; the parent solves what each learned anew and scores it.
"""

from collections.abc import Sequence


def main(argv: Sequence[str]) -> None:
    from benchmarks.fit.compare import main as compare

    compare(argv)
