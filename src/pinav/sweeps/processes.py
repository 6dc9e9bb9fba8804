"""Workers that are processes of this machine; they speak lines of text."""

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor

from pinav.errors import InputError
from pinav.numerics import ONE_CORE
from pinav.sweeps.engines import AbstractEngine, WorkerDeath

OUTSIDE = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
"""Signals by which operators, schedulers and a lack of memory end a process."""


class LocalProcesses(AbstractEngine):
    """Fresh processes on this machine, each with one core.

    A process does many cells, so that cells of one shape compile once. One that dies is
    replaced when its place gets the next cell.

    Attributes:
        count: number of processes.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._workers: dict[str, subprocess.Popen[str]] = {}
        self._threads = ThreadPoolExecutor(count)

    @property
    def description(self) -> str:
        return f"{self.count} processes of this machine"

    def places(self) -> Sequence[str]:
        return [str(number) for number in range(self.count)]

    def submit(self, place: str, version: str, order: str) -> Future[str]:
        return self._threads.submit(self._ask, place, json.dumps([version, order]))

    def _ask(self, place: str, line: str) -> str:
        """Send an order and wait for the answer.

        Raises:
            WorkerDeath: there was none.
        """
        worker = self._workers.get(place)
        if worker is not None and worker.poll() is not None:
            _close(worker)  # it died between two orders
            worker = None
        if worker is None:
            worker = self._workers[place] = self._start()
        assert worker.stdin is not None
        assert worker.stdout is not None
        answer = ""
        with contextlib.suppress(BrokenPipeError, ValueError):
            worker.stdin.write(line + "\n")
            worker.stdin.flush()
            answer = worker.stdout.readline()
        if answer.endswith("\n"):
            return json.loads(answer)
        code = worker.wait()
        _close(worker)
        raise WorkerDeath(worker.pid, killed=-code in OUTSIDE)

    def _start(self) -> subprocess.Popen[str]:
        """A new process; variables of the environment limit what it may use."""
        environment = os.environ | {
            "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
            "JAX_ENABLE_X64": "true",
            "TQDM_DISABLE": "1",
            **ONE_CORE,
        }
        command = [sys.executable, "-m", "pinav.sweeps.worker"]
        try:
            return subprocess.Popen(
                command,
                env=environment,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                encoding="utf-8",
            )
        except OSError as error:
            raise InputError(
                f"--workers: a process cannot be started: {error.strerror or error}"
            ) from error

    def close(self) -> None:
        for worker in self._workers.values():
            worker.kill()
        self._threads.shutdown()
        for worker in self._workers.values():
            worker.wait()
            _close(worker)


def _close(worker: subprocess.Popen[str]) -> None:
    """Close the pipes of a worker that has ended."""
    for pipe in (worker.stdin, worker.stdout):
        if pipe is not None:
            with contextlib.suppress(BrokenPipeError):  # of an order that came too late
                pipe.close()
