"""The command `pinav bench`."""

from pinav.commands.command import Command

BENCH = Command(
    name="bench",
    summary="run a benchmark and print its table",
    options="pinav.commands.bench.settings:BenchOptions",
    run="pinav.commands.bench.job:run",
    forwards=True,
    compilation_cache=False,  # benchmarks measure cold processes
)
