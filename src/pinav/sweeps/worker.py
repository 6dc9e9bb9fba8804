"""A worker process: reads orders from its input, one line each, and answers in turn.

Started as `python -m pinav.sweeps.worker`; it ends when its input does, which
is when its client ends, however that ends.
"""

import json
import os
import signal
import sys
import threading
from queue import SimpleQueue


def main() -> None:
    """Work until the input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the client says when to stop
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what a cell prints is no answer
    orders: SimpleQueue[str] = SimpleQueue()
    threading.Thread(target=_read, args=(orders,), daemon=True).start()
    from pinav.sweeps.attempt import attempt

    while True:
        version, order = json.loads(orders.get())
        answers.write(json.dumps(attempt(version, order)) + "\n")
        answers.flush()


def _read(orders: "SimpleQueue[str]") -> None:
    """Take orders while a cell is worked on, so that the client's end is noticed."""
    for line in sys.stdin:
        orders.put(line)
    os._exit(0)


if __name__ == "__main__":
    main()
