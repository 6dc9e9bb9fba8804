"""Benchmark: what a command's first minute goes into, in processes of their own.

Imports until the run begins; tracing and lowering, compilation, by what JAX reports;
the rest is arithmetic, files and figures. Seconds of processor time stand beside those
of the clock, because other work on a machine spoils the latter.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import tyro

from pinav.commands.parsing import parse
from pinav.commands.settings import Settings
from pinav.errors import FitError, InputError

COMMANDS: dict[str, tuple[str, ...]] = {
    "reproduce": ("reproduce",),
    "fit": ("fit", "{data}"),
    "evaluate": ("evaluate", "{fit}", "{data}"),
    "discover": ("discover", "{fit}"),
    "report": ("report", "{fit}"),
    "navigate": ("navigate", "{fit}", "--from=1,1", "--to=8,8"),
    "heat": ("heat", "simulate", "{heat}"),
    "identify": ("identify", "{recording}"),
}
"""Words of each command; a name in braces is a file that is made or given."""

IN_PLACE = ("evaluate", "discover", "report")
"""Commands that write into the run that they are given."""

TRACING = ("jaxpr_trace_duration", "jaxpr_to_mlir_module_duration")
COMPILING = "backend_compile_duration"


class Phases(msgspec.Struct, frozen=True):
    """Where the time of one process went [s].

    Attributes:
        clock: all of it, by the clock.
        processor: all of it, over all threads.
        imports: until the run began, by the clock.
        tracing: tracing and lowering.
        compiling: compilation, or reading what was compiled before.
        programs: number of programs that were compiled or read.
    """

    clock: float
    processor: float
    imports: float
    tracing: float
    compiling: float
    programs: int

    def line(self, name: str) -> str:
        """The row of the table."""
        rest = self.clock - self.imports - self.tracing - self.compiling
        parts = (self.imports, self.tracing, self.compiling, rest)
        cells = [self.clock, self.processor, *parts]
        return (
            f"{name:<18}"
            + "".join(f"{x:>10.1f}" for x in cells)
            + (f"{self.programs:>10}")
        )


HEADER = (
    f"{'command':<18}"
    + "".join(
        f"{word:>10}"
        for word in ("clock", "processor", "imports", "tracing", "compiling", "rest")
    )
    + f"{'programs':>10}"
)


class Options(Settings, frozen=True):
    """Time the first runs of commands, without and with compiled code on disk."""

    commands: Annotated[
        tuple[str, ...], tyro.conf.arg(help="Any of: " + ", ".join(COMMANDS) + ".")
    ] = ("reproduce", "fit", "evaluate", "navigate", "heat")
    recording: Annotated[
        Path | None, tyro.conf.arg(help="A recording, for the command identify.")
    ] = None

    def check_together(self) -> None:
        for name in self.commands:
            if name not in COMMANDS:
                known = ", ".join(COMMANDS)
                raise InputError(
                    f"--commands: {name!r} is unknown; choose some of: {known}"
                )
        if "identify" in self.commands and self.recording is None:
            raise InputError("--recording: identify needs a file of a tracker")


def main(argv: Sequence[str]) -> None:
    options = parse(Options, argv, prog="pinav bench start")
    if options is None:
        return
    options.check()
    print(HEADER)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        files = {
            "data": folder / "data.csv",
            "fit": folder / "fit-warm",
            "heat": Path(__file__).parents[1] / "examples" / "heat" / "tumour.toml",
            "recording": options.recording,
        }
        simulation = ("barrier-crossings", "--count", "8", "--noise", "0.02")
        run(folder, "simulate", *simulation, "--out", str(files["data"]))
        if {*IN_PLACE, "navigate"} & {*options.commands}:
            run(folder, "fit", str(files["data"]), "--out", str(files["fit"]))
        for name in options.commands:
            for state in ("cold", "warm"):
                words = [word.format(**files) for word in COMMANDS[name]]
                if name not in IN_PLACE:
                    words += ["--out", str(folder / f"{name}-{state}"), "--overwrite"]
                phases = run(folder, *words, cache=folder / f"cache-{name}")
                print(phases.line(f"{name} {state}"), flush=True)


def run(folder: Path, *words: str, cache: Path | None = None) -> Phases:
    """Run a command in a process of its own.

    Args:
        folder: for the child's report.
        words: of the command line.
        cache: folder of compiled code; a shared one unless given.

    Raises:
        FitError: the command failed.
    """
    report = folder / "phases.json"
    environment = os.environ | {
        "XDG_CACHE_HOME": str(cache or folder / "cache"),
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
        "TQDM_DISABLE": "1",
    }
    command = [sys.executable, "-m", "benchmarks.start", str(report), *words]
    begin = time.perf_counter()
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    clock = time.perf_counter() - begin
    if done.returncode:
        raise FitError(f"pinav {' '.join(words)}: {done.stderr.strip()[-300:]}")
    phases = msgspec.json.decode(report.read_bytes(), type=Phases)
    return msgspec.structs.replace(phases, clock=clock)


def child(report: Path, words: Sequence[str]) -> int:
    """Run a command and write where its time went."""
    begin = time.perf_counter()
    from pinav import cli

    spent = {"tracing": 0.0, "compiling": 0.0}
    started, programs = [begin], []

    def listen(event: str, duration_secs: float, **_: object) -> None:
        if event.endswith(TRACING):
            spent["tracing"] += duration_secs
        if event.endswith(COMPILING):
            spent["compiling"] += duration_secs
            programs.append(event)

    def start() -> None:
        from jax import monitoring

        monitoring.register_event_duration_secs_listener(listen)
        started.append(time.perf_counter())

    code = cli.run(words, on_start=start)
    report.write_text(
        json.dumps(
            {
                "clock": 0.0,
                "processor": time.process_time(),
                "imports": started[-1] - begin,
                "programs": len(programs),
                **spent,
            }
        )
    )
    return code


if __name__ == "__main__":
    sys.exit(child(Path(sys.argv[1]), sys.argv[2:]))
