"""The command line: parses, calls a job, prints. One module per command is loaded."""

import io
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Sequence

from pinav import __version__
from pinav.commands import COMMANDS
from pinav.commands.command import Command
from pinav.numerics import prepare_process

USAGE_ERROR, INTERRUPTED = 2, 130


OnStart = Callable[[], None]


def main(
    argv: Sequence[str] | None = None,
    program: Callable[[Sequence[str], OnStart], int] | None = None,
) -> None:
    """Entry point of the `pinav` command; exits the process.

    Args:
        program: Another program, which returns its exit code as `run` does.
    """
    words = sys.argv[1:] if argv is None else list(argv)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # where a terminal knows ASCII alone
    try:
        code = (program or run)(words, _interruptible)
        sys.stdout.flush()
    except BrokenPipeError:  # the reader of a pipe has left, which is its right
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 0
    except KeyboardInterrupt:
        code = _complain("interrupted", code=INTERRUPTED)
    sys.exit(code)


SIGNALLED = threading.Event()
"""Set once an interrupt was asked for.

Compiled libraries that call Python turn the `KeyboardInterrupt` inside such a call into
an error of their own, so that the exception alone does not tell an interrupt.
"""


def _interruptible() -> None:
    signal.signal(signal.SIGINT, _interrupt)


def _interrupt(number: int, frame: object) -> None:
    del number, frame
    SIGNALLED.set()
    raise KeyboardInterrupt


def run(argv: Sequence[str], on_start: OnStart = lambda: None) -> int:
    """Run one command and return its exit code.

    Args:
        on_start: called when all modules are imported and the run begins.
    """
    if not argv or argv[0] in ("-h", "--help"):
        print(overview())
        return 0
    if argv[0] in ("-V", "--version"):
        print(f"pinav {__version__}")
        return 0
    command = command_named(argv[0])
    if command is None:
        return _complain(
            f"unknown command {argv[0]!r}{_suggestion(argv[0])}; see pinav --help"
        )
    prepare_process(flags=command.compiler_flags)
    from pinav.commands.dispatch import execute

    return exit_code(
        lambda: execute(command, argv[1:], on_start), again=_again(command, argv)
    )


def exit_code(work: Callable[[], None], *, again: str = "") -> int:
    """Do a piece of work; say in one line what is wrong with it.

    Args:
        again: The command that goes on with it; empty where nothing is kept.
    """
    try:
        _check_limits()
        work()
    except KeyboardInterrupt:
        return _complain(_how_to_go_on(again), code=INTERRUPTED)
    except Exception as error:
        if SIGNALLED.is_set():
            return _complain(_how_to_go_on(again), code=INTERRUPTED)
        return _complain_of(error, resumable=bool(again))
    return 0


def _complain_of(error: Exception, *, resumable: bool) -> int:
    """Say what is wrong in one line; raise an error of our own."""
    from pinav.errors import FitError, InputError

    match error:
        case InputError():
            return _complain(str(error))
        case FitError():
            return _complain(str(error), code=1)
        case BrokenPipeError():
            raise error
        case OSError():
            return _complain(_about_files(error, resumable=resumable))
        case MemoryError():
            line = f"not enough memory: {error}; give less data at once"
            return _complain(line, code=1)
        case RuntimeError() if "RESOURCE_EXHAUSTED" in str(error):
            return _complain("not enough memory; give less data at once", code=1)
    raise error


def _about_files(error: OSError, *, resumable: bool) -> str:
    place = f"{error.filename}: " if error.filename else ""
    advice = "then continue with --resume" if resumable else "then repeat it"
    reason = error.strerror or error
    return f"{place}{reason}; free the place or change the path, {advice}"


LEAST_MEMORY = 4 * 2**30
"""Address space below which the compiled libraries abort [bytes]."""


def _check_limits() -> None:
    """Refuse a limit of address space under which libraries abort without a word."""
    try:
        import resource
    except ImportError:  # not on this platform
        return
    from pinav.errors import InputError

    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and limit < LEAST_MEMORY:
        raise InputError(
            f"the limit of virtual memory is {limit // 2**20} MiB; raise it to 4 GiB "
            "or more (ulimit -v)"
        )


def command_named(name: str) -> Command | None:
    """The command of that name, if there is one."""
    return next((command for command in COMMANDS if command.name == name), None)


def overview() -> str:
    """What `pinav --help` prints."""
    width = max(len(command.name) for command in COMMANDS)
    lines = [f"  {c.name:<{width}}  {c.summary}" for c in COMMANDS]
    return "\n".join(
        [
            "usage: pinav COMMAND [options]",
            "",
            "Learn the unknown force on a driven microswimmer from its trajectories.",
            "",
            "commands:",
            *lines,
            "",
            "pinav COMMAND --help explains a command.",
            "Start with: pinav reproduce --out runs/paper",
        ]
    )


def _suggestion(word: str) -> str:
    import difflib

    close = difflib.get_close_matches(word, [c.name for c in COMMANDS], n=1)
    return f" (did you mean {close[0]}?)" if close else ""


def _again(command: Command, argv: Sequence[str]) -> str:
    """The command line that continues a run; empty where it cannot be continued."""
    if not command.resumable:
        return ""
    import shlex

    words = [word for word in argv if word not in ("--overwrite", "--resume")]
    return shlex.join(["pinav", *words, "--resume"])


def _how_to_go_on(again: str) -> str:
    if not again:
        return "interrupted"
    return f"interrupted; what was done is saved; continue with: {again}"


WORDS_OF_THE_LIBRARY = (
    (r",? or (pass )?throw=False[^;.]*", ""),
    (r"max_iterations", "--max-steps"),
    (r", add substeps", ""),
    (r"; pass key=jax\.random\.key\(seed\)", ""),
)
"""What messages say to a caller in Python, and what the command line says instead."""


def _complain(message: str, code: int = USAGE_ERROR) -> int:
    line = " ".join(message.split())
    for pattern, words in WORDS_OF_THE_LIBRARY:
        line = re.sub(pattern, words, line)
    print(f"pinav: {line}", file=sys.stderr)
    return code
