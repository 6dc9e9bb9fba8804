"""Where commands go: a file that grows, a socket, the rig's own connection."""

import abc
import os
import socket
import time
from pathlib import Path

from pinav.live.sources import FIRST_WAIT, LONGEST_WAIT, AbstractSource, address_of


class AbstractSink(abc.ABC):
    """What takes lines of commands."""

    @abc.abstractmethod
    def write(self, data: bytes) -> None:
        """Pass whole lines on; what cannot be delivered is dropped, never kept."""


class SourceSink(AbstractSink):
    """The connection that frames come from."""

    def __init__(self, source: AbstractSource) -> None:
        self.source = source

    def write(self, data: bytes) -> None:
        self.source.write(data)


class FileSink(AbstractSink):
    """The end of a file; each line is there when the call returns."""

    def __init__(self, path: Path) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND
        self._descriptor = os.open(path, flags, 0o644)

    def write(self, data: bytes) -> None:
        os.write(self._descriptor, data)


class SocketSink(AbstractSink):
    """Another connection; while there is none, commands are dropped, for they age."""

    def __init__(self, host: str, port: int) -> None:
        self.address = (host, port)
        self._socket: socket.socket | None = None
        self._wait, self._next = FIRST_WAIT, 0.0

    def write(self, data: bytes) -> None:
        now = time.monotonic()
        try:
            if self._socket is None and now >= self._next:
                self._socket = socket.create_connection(self.address, timeout=0.2)
                self._wait = FIRST_WAIT
            if self._socket is not None:
                self._socket.sendall(data)
        except OSError:
            if self._socket is not None:
                self._socket.close()
            self._socket = None
            self._next = now + self._wait
            self._wait = min(2 * self._wait, LONGEST_WAIT)


def sink_of(text: str | None, source: AbstractSource, token: str = "") -> AbstractSink:
    """The sink that a word of the command line means; unless given, the source.

    Raises:
        InputError: it is no usable address.
    """
    if text is None:
        return SourceSink(source)
    address = address_of(text, token)
    return FileSink(Path(text)) if address is None else SocketSink(*address)
