"""Who does the cells: this process, or any executor of `concurrent.futures`."""

import abc
from collections.abc import Sequence
from concurrent.futures import CancelledError, Executor, Future

from pinav.errors import InputError
from pinav.sweeps.attempt import attempt


class WorkerDeath(Exception):
    """A worker died before it answered.

    Attributes:
        pid: of its process on this machine; none where that is not known.
        killed: a signal from outside ended it, not a fault of the cell.
    """

    def __init__(self, pid: int | None = None, *, killed: bool = False) -> None:
        super().__init__("a worker died")
        self.pid, self.killed = pid, killed


class AbstractEngine(abc.ABC):
    """Hands cells to workers, of which each does one at a time."""

    @property
    @abc.abstractmethod
    def description(self) -> str:
        """What does the work, for people; with the address of its page, if any."""

    @abc.abstractmethod
    def places(self) -> Sequence[str]:
        """Names of the workers that there are now."""

    @abc.abstractmethod
    def submit(self, place: str, version: str, order: str) -> Future[str]:
        """Let a worker call `attempt`; `WorkerDeath` is raised where it dies."""

    @abc.abstractmethod
    def close(self) -> None:
        """Let the workers go; what they are doing is given up."""

    def check_death(self, error: BaseException) -> WorkerDeath:
        """The death of a worker that an exception of a future stands for.

        Raises:
            BaseException: it stands for something else.
        """
        if isinstance(error, WorkerDeath):
            return error
        raise error


class InThisProcess(AbstractEngine):
    """One cell after the other, here."""

    @property
    def description(self) -> str:
        return "one cell at a time, in the process of the command"

    def places(self) -> Sequence[str]:
        return ("here",)

    def submit(self, place: str, version: str, order: str) -> Future[str]:
        del place
        future: Future[str] = Future()
        future.set_result(attempt(version, order))
        return future

    def close(self) -> None:
        pass


class OfExecutor(AbstractEngine):
    """The workers of an executor of `concurrent.futures` that the caller made.

    Attributes:
        executor: that takes functions and text; it stays open.
        width: cells that it does at once.
    """

    def __init__(self, executor: Executor, width: int) -> None:
        self.executor, self.width = executor, width

    @property
    def description(self) -> str:
        return f"{self.width} workers of {type(self.executor).__name__}"

    def places(self) -> Sequence[str]:
        return [str(number) for number in range(self.width)]

    def submit(self, place: str, version: str, order: str) -> Future[str]:
        del place
        return self.executor.submit(attempt, version, order)

    def close(self) -> None:
        pass

    def check_death(self, error: BaseException) -> WorkerDeath:
        """Without its pool no further cell can be done."""
        if isinstance(error, CancelledError) or type(error).__name__.startswith("Brok"):
            raise InputError(
                "the executor has lost its workers; what is done is kept: make a new "
                "one and continue"
            ) from error
        raise error
