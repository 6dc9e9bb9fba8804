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
    "navigate": ("navigate", "{fit}", "--from=-1,-1", "--to=11,-1"),
    "heat": ("heat", "simulate", "{heat}"),
    "identify": ("identify", "{recording}"),
}
"""Words of each command; a name in braces is a file that is made or given. The places
of `navigate` are off the barrier, whose slopes are steeper than the thrust."""

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

    def cells(self) -> str:
        """The row of the table, less its name."""
        rest = self.clock - self.imports - self.tracing - self.compiling
        parts = (self.imports, self.tracing, self.compiling, rest)
        numbers = (self.clock, self.processor, *parts)
        return "".join(f"{x:>10.1f}" for x in numbers) + f"{self.programs:>10}"


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
    ] = tuple(COMMANDS)
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


def main(argv: Sequence[str]) -> None:
    options = parse(Options, argv, prog="python -m benchmarks start")
    if options is None:
        return
    options.check()
    print(HEADER)
    with tempfile.TemporaryDirectory() as place:
        files = Files(Path(place), options.recording)
        for name in options.commands:
            for state in ("cold", "warm"):
                print(f"{name} {state}".ljust(18) + row(files, name, state), flush=True)


def row(files: "Files", name: str, state: str) -> str:
    """Cells of a command, or the reason why it has none."""
    try:
        words = [files.resolve(word) for word in COMMANDS[name]]
        if name not in IN_PLACE:
            words += ["--out", str(files.folder / f"{name}-{state}"), "--overwrite"]
        return run(files.folder, *words, cache=files.folder / f"cache-{name}").cells()
    except (FitError, InputError) as error:
        return f"  no figures: {error}"


class Files:
    """Files that commands are given; those that must be made are made when asked for.

    Attributes:
        folder: where they are.
        recording: of a tracker, where there is one.
    """

    def __init__(self, folder: Path, recording: Path | None) -> None:
        self.folder = folder
        self.recording = recording

    def resolve(self, word: str) -> str:
        """A word of a command line, its file in braces made.

        Raises:
            FitError: it cannot be made.
            InputError: it must be given, and is not.
        """
        known = {
            "{data}": self.data,
            "{fit}": self.fit,
            "{heat}": lambda: Path(__file__).parents[1] / "examples/heat/tumour.toml",
            "{recording}": self.given,
        }
        return str(known[word]()) if word in known else word

    def data(self) -> Path:
        """Eight noisy trajectories."""
        made = self.folder / "data.csv"
        if not made.exists():
            words = ("barrier-crossings", "--count", "8", "--noise", "0.02")
            run(self.folder, "simulate", *words, "--out", str(made))
        return made

    def fit(self) -> Path:
        """The fit of these trajectories."""
        made = self.folder / "fit-of-others"
        if not (made / "metrics.json").exists():
            words = (str(self.data()), "--out", str(made), "--overwrite")
            run(self.folder, "fit", *words)
        return made

    def given(self) -> Path:
        """The recording."""
        if self.recording is None:
            raise InputError("--recording: identify needs a file of a tracker")
        return self.recording


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
        reason = " ".join(done.stderr.split())[-300:]
        raise FitError(f"pinav {' '.join(words)}: {reason}")
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
