"""Workers of a Dask cluster that runs already."""

import importlib
import importlib.util
import os
import sys
from collections.abc import Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import msgspec

from pinav.errors import InputError
from pinav.numerics import ONE_CORE, prepare_process
from pinav.sweeps.attempt import attempt
from pinav.sweeps.engines import AbstractEngine, WorkerDeath

CONNECTION_TIME = 10.0
"""How long a scheduler may take to answer [s]."""

PAUSE = 2.0
"""How often it is asked whether an answer is lost [s]."""

MOST_WORKERS = 1000
"""Cells at once."""


class TlsFiles(msgspec.Struct, frozen=True):
    """Files that let a client and a cluster know each other, as Dask has them.

    Attributes:
        ca: certificate of the authority that both trust.
        cert: the client's certificate.
        key: its private key.
    """

    ca: Path
    cert: Path
    key: Path


class DaskCluster(AbstractEngine):
    """The workers of the Dask scheduler at an address, as they come and go.

    Attributes:
        address: such as tcp://host:8786, or tls://host:8786.

    Raises:
        InputError: Dask is not installed, nobody answers, or not in time.
    """

    def __init__(self, address: str, tls: TlsFiles | None = None) -> None:
        if importlib.util.find_spec("distributed") is None:
            raise InputError(
                "--scheduler: Dask is not installed; pip install 'pinav[cluster]'"
            )
        self.address = address
        distributed: Any = importlib.import_module("distributed")
        security = {} if tls is None else {"security": _security(distributed, tls)}
        try:
            self._client = distributed.Client(
                address, timeout=CONNECTION_TIME, set_as_default=False, **security
            )
        except (OSError, ValueError, TypeError) as error:
            reason = str(error) or "nobody answers"
            raise InputError(f"--scheduler {address}: {reason}") from error
        self._threads = ThreadPoolExecutor(MOST_WORKERS)

    @property
    def description(self) -> str:
        page = self._client.dashboard_link
        return f"the Dask cluster at {self.address} ({page})"

    def places(self) -> Sequence[str]:
        if self._client.status not in ("running", "connecting"):
            raise InputError(self._gone)
        return list(self._client.scheduler_info(n_workers=-1).get("workers", ()))

    @property
    def _gone(self) -> str:
        return (
            f"the scheduler at {self.address} is gone; what is done is kept: continue "
            "with --resume and a scheduler that runs"
        )

    def submit(self, place: str, version: str, order: str) -> Future[str]:
        del place
        return self._threads.submit(self._ask, version, order)

    def _ask(self, version: str, order: str) -> str:
        """Send an order and wait for the answer.

        Dask's own executor waits for ever for an answer that is lost with its worker.

        Raises:
            WorkerDeath: the answer is lost.
        """
        # Dask chooses the worker: with one that it should prefer, a cell whose worker
        # died was never given to the next.
        future = self._client.submit(attempt_elsewhere, version, order, pure=False)
        while True:
            try:
                return future.result(timeout=PAUSE)
            except TimeoutError:
                if self._client.status != "running":
                    raise ConnectionError("the connection is closed") from None
                if future.status != "pending":
                    raise WorkerDeath from None

    def close(self) -> None:
        self._client.close()
        self._threads.shutdown()

    def check_death(self, error: BaseException) -> WorkerDeath:
        name = type(error).__name__
        if name == "KilledWorker":
            return WorkerDeath()
        if (
            isinstance(error, CancelledError | OSError)
            or name == "FutureCancelledError"
        ):
            raise InputError(self._gone) from error
        if isinstance(error, ImportError | AttributeError):
            raise InputError(
                f"a worker of {self.address} cannot load pinav ({error}); install the "
                "version of the client there"
            ) from error
        raise error


def attempt_elsewhere(version: str, order: str) -> str:
    """`attempt` in a process that Dask started: prepared as those of pinav are."""
    prepare_process()
    os.environ.update(ONE_CORE)
    os.environ["JAX_ENABLE_X64"] = "true"
    if "jax" in sys.modules:  # imported before, by someone else
        importlib.import_module("jax").config.update("jax_enable_x64", val=True)
    return attempt(version, order)


def _security(distributed: Any, tls: TlsFiles) -> Any:
    return distributed.Security(
        tls_ca_file=str(tls.ca),
        tls_client_cert=str(tls.cert),
        tls_client_key=str(tls.key),
        require_encryption=True,
    )
