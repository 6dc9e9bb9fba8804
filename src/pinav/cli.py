"""The command line: parses, calls a job, prints. One module per command is loaded."""

import os
import sys
from collections.abc import Sequence

from pinav import __version__

COMMANDS = {
    "reproduce": "run the paper's experiment: simulate, train, Table 2, report",
    "simulate": "write the trajectories of a named scenario to a file",
    "fit": "fit a model of the unknown force to trajectories",
    "compare": "weigh the evidence of several models of the same data",
    "evaluate": "score a fitted run on trajectories",
    "report": "draw the figures and the HTML page of a run again",
    "bench": "run a benchmark and print its table",
}

USAGE_ERROR, INTERRUPTED = 2, 130


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point of the `pinav` command; exits the process."""
    sys.exit(run(sys.argv[1:] if argv is None else list(argv)))


def run(argv: Sequence[str]) -> int:
    """Run one command and return its exit code.

    Args:
        argv: the words after `pinav`.
    """
    if not argv or argv[0] in ("-h", "--help"):
        print(overview())
        return 0
    if argv[0] in ("-V", "--version"):
        print(f"pinav {__version__}")
        return 0
    if argv[0] not in COMMANDS:
        return _complain(
            f"unknown command {argv[0]!r}{_suggestion(argv[0])}; see pinav --help"
        )
    # Two pools of threads on the same cores slow small factorisations tenfold.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from pinav import commands
    from pinav.errors import FitError, InputError

    try:
        commands.dispatch(argv[0], argv[1:])
    except InputError as error:
        return _complain(str(error))
    except FitError as error:
        return _complain(str(error), code=1)
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        return _complain(
            f"{place}{error.strerror or error}; free the place or change the path, "
            "then go on with --resume"
        )
    except KeyboardInterrupt:
        return _complain(_how_to_go_on(argv), code=INTERRUPTED)
    return 0


def overview() -> str:
    """What `pinav --help` prints."""
    width = max(map(len, COMMANDS))
    lines = [f"  {name:<{width}}  {what}" for name, what in COMMANDS.items()]
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

    close = difflib.get_close_matches(word, COMMANDS, n=1)
    return f" (did you mean {close[0]}?)" if close else ""


def _how_to_go_on(argv: Sequence[str]) -> str:
    words = [word for word in argv if word != "--overwrite"]
    if argv[0] in ("reproduce", "fit"):
        words += [] if "--resume" in argv else ["--resume"]
        import shlex

        command = shlex.join(["pinav", *words])
        return f"interrupted; what was done is saved; go on with: {command}"
    return "interrupted"


def _complain(message: str, code: int = USAGE_ERROR) -> int:
    line = " ".join(message.split())
    print(f"pinav: {line}", file=sys.stderr)
    return code
