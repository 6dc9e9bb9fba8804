"""Workers of Dask: processes of this machine, or those of a scheduler that runs."""

import contextlib
import importlib
import logging
import signal
from collections.abc import Iterator, Sequence
from multiprocessing import resource_tracker
from typing import Any

from pinav.errors import InputError
from pinav.sweeps import attempt

CONNECTION_TIME = 10.0
"""How long a scheduler may take to answer [s]."""


class Cluster:
    """The workers of a Dask scheduler, as they come and go; each does one cell.

    Attributes:
        description: what does the work, for people.
    """

    def __init__(self, client: Any, description: str) -> None:
        self.client, self.description = client, description

    def workers(self) -> Sequence[str]:
        """Addresses of the workers that there are now."""
        with contextlib.suppress(OSError):  # of a connection that breaks just now
            if self.client.status in ("running", "connecting"):
                # of a scheduler that has just died there is no such entry
                return list(self.client.scheduler_info(n_workers=-1).get("workers", ()))
        raise InputError(
            f"the scheduler of {self.description} is gone; what is done is kept: "
            "continue with --resume and a scheduler that runs"
        )

    def submit(self, place: str, version: str, order: str) -> Any:
        """Hand an order to a worker; the future of its answer.

        Args:
            order: an `Order` as JSON.
        """
        return self.client.submit(
            attempt.attempt_here,
            version,
            order,
            workers=[place],
            allow_other_workers=False,
            pure=False,
        )

    def wait(self, futures: Sequence[Any], seconds: float) -> None:
        """Wait until one of the futures has its answer, or for some seconds."""
        if any(future.status != "pending" for future in futures):
            return
        distributed: Any = importlib.import_module("distributed")
        lost = distributed.CancelledError  # their status tells which
        with contextlib.suppress(TimeoutError, lost), self.client.as_current():
            distributed.wait(futures, timeout=seconds, return_when="FIRST_COMPLETED")

    def answer(self, future: Any) -> str | None:
        """The answer of a worker that is through; none where it was lost.

        Raises:
            InputError: the scheduler is gone, or a worker cannot load pinav.
        """
        if future.status == "finished":
            return future.result()
        error = future.exception() if future.status == "error" else None
        if isinstance(error, ImportError | AttributeError):
            raise InputError(
                f"a worker of {self.description} cannot load pinav ({error}); install "
                "the version of the client there"
            ) from error
        if error is None or type(error).__name__ == "KilledWorker":
            return None
        raise error


@contextlib.contextmanager
def local_cluster(count: int) -> Iterator[Cluster]:
    """Fresh processes of this machine, each with one core; one that dies is replaced.

    Raises:
        InputError: the processes cannot be started.
    """
    distributed: Any = importlib.import_module("distributed")
    try:
        with _without_interrupts():
            cluster = distributed.LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                processes=True,
                memory_limit=None,  # the system ends what takes too much
                dashboard_address="127.0.0.1:0",  # any free port
                silence_logs=logging.CRITICAL,
                env=attempt.SETTINGS,
                preload=attempt.__name__,
            )
    except (OSError, RuntimeError) as error:
        raise InputError(
            f"--workers: a process cannot be started: {error.__cause__ or error}"
        ) from error
    with cluster, distributed.Client(cluster, set_as_default=False) as client:
        yield Cluster(client, f"{count} processes of this machine")


@contextlib.contextmanager
def _without_interrupts() -> Iterator[None]:
    """Leave interrupts to this thread: what starts within gets none.

    Workers then end when the client says so, and not with complaints of their own.
    """
    resource_tracker.ensure_running()  # which lets interrupts through when it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def cluster_at(address: str) -> Iterator[Cluster]:
    """The workers of the scheduler at an address.

    The certificates of one at tls:// are those of Dask's own configuration.

    Args:
        address: such as tcp://host:8786, or tls://host:8786.

    Raises:
        InputError: nobody answers, or not in time.
    """
    distributed: Any = importlib.import_module("distributed")
    try:
        client = distributed.Client(
            address, timeout=CONNECTION_TIME, set_as_default=False
        )
    except (OSError, ValueError, TypeError) as error:
        reason = str(error) or "nobody answers"
        raise InputError(f"--workers {address}: {reason}") from error
    with client:
        page = client.dashboard_link
        yield Cluster(client, f"the Dask cluster at {address} ({page})")
