"""The process of the command line, `pinav` or `python -m pinav`.

An interrupt inside the imports of compiled libraries is lost or crashes. Nothing is
written until a run begins, so that until then it ends the process at once.
"""

import atexit
import contextlib
import os
import signal
import sys


def main() -> None:
    """Entry point of the `pinav` command; exits the process."""
    signal.signal(signal.SIGINT, _leave)
    code = 1  # of an error that nobody foresaw, which Python prints

    def end() -> None:
        # To take modules and compiled programs down one by one takes up to a second.
        # Besides, Python remembers an interrupt that passed through compiled code, and
        # would end with a signal in place of the exit status.
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):  # closed by who reads it
                stream.flush()
        os._exit(code)

    atexit.register(end)  # what registers first is called last
    from pinav.cli import main as run

    try:
        run()
    except SystemExit as leave:
        code = leave.code if isinstance(leave.code, int) else int(bool(leave.code))
        raise
    finally:  # the work is done: an interrupt while Python ends has nothing to stop
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _leave(number: int, frame: object) -> None:
    del number, frame
    os.write(2, b"pinav: interrupted\n")
    os._exit(130)


if __name__ == "__main__":
    main()
