"""The process of the command line, `pinav` or `python -m pinav`.

An interrupt inside the imports of compiled libraries is lost or crashes. Nothing is
written until a run begins, so that until then it ends the process at once.
"""

import os
import signal


def main() -> None:
    """Entry point of the `pinav` command; exits the process."""
    signal.signal(signal.SIGINT, _leave)
    from pinav.cli import main as run

    try:
        run()
    finally:  # the work is done: an interrupt while Python ends has nothing to stop
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _leave(number: int, frame: object) -> None:
    del number, frame
    os.write(2, b"pinav: interrupted\n")
    os._exit(130)


if __name__ == "__main__":
    main()
