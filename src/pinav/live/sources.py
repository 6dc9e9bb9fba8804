"""The sources of lines and the sinks of commands: files that grow, sockets, streams."""

import abc
import dataclasses
import os
import select
import socket
import time
from io import FileIO
from pathlib import Path

from pinav.errors import InputError
from pinav.live.messages import LONGEST

CHUNK = 256 * 1024
"""Bytes that are read at once."""

FIRST_WAIT, LONGEST_WAIT = 0.1, 5.0
"""Seconds until a connection is tried again: doubled from the first to the longest."""

POLL = 0.01
"""Seconds between two looks at a file that has not grown."""


@dataclasses.dataclass(frozen=True)
class Reading:
    """Result of reading a source.

    Attributes:
        fresh: bytes do not continue those before: a half line is dropped.
    """

    data: bytes = b""
    fresh: bool = False
    text: str = ""
    ended: bool = False


@dataclasses.dataclass(frozen=True)
class LineBuffer:
    """The half line that waits for its newline.

    Of a line that grows beyond the longest one only its first bytes are kept, so that
    memory is bounded; it is returned when it ends and refused for its length.
    """

    half: bytes = b""

    def after(self, data: bytes) -> tuple["LineBuffer", list[bytes]]:
        """The buffer and the lines that are complete after more bytes."""
        *lines, half = (self.half + data).split(b"\n")
        lines = [line[: LONGEST + 1].rstrip(b"\r") for line in lines]
        return LineBuffer(half[: LONGEST + 1]), [line for line in lines if line]


class AbstractSink(abc.ABC):
    """A receiver of commands."""

    @abc.abstractmethod
    def write(self, data: bytes) -> None:
        """Pass whole lines on; what cannot be delivered is dropped, never kept."""


class AbstractSource(AbstractSink):
    """Bytes of a rig, which takes the answers where it can be answered."""

    @abc.abstractmethod
    def read(self, wait: float) -> Reading:
        """The bytes that arrive within so many seconds."""

    @abc.abstractmethod
    def hang_up(self) -> None:
        """Leave a rig that does not keep to the protocol."""

    @abc.abstractmethod
    def close(self) -> None:
        """Release what is open."""


class FileSource(AbstractSource):
    """A file that grows; rotated and truncated ones are read from their start."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: FileIO | None = None

    def read(self, wait: float) -> Reading:
        if self._file is None:
            return self._open(wait)
        if data := self._file.read(CHUNK):
            return Reading(data)
        if text := self._replacement():
            # The old file may have grown between the read and the look.
            last = self._file.read()
            if last:
                return Reading(last)
            self.close()
            return Reading(fresh=True, text=text)
        time.sleep(min(wait, POLL))
        return Reading()

    def _open(self, wait: float) -> Reading:
        if not self.path.exists():
            time.sleep(min(wait, POLL))
            return Reading()
        self._file = self.path.open("rb", buffering=0)
        return Reading(fresh=True)

    def _replacement(self) -> str:
        """Change of the file under this name; empty where it is the same."""
        assert self._file is not None
        try:
            now = os.stat(self.path)
        except FileNotFoundError:
            return ""
        ours = os.fstat(self._file.fileno())
        if (now.st_ino, now.st_dev) != (ours.st_ino, ours.st_dev):
            return "the file was rotated; the new one is read from its start"
        if now.st_size < self._file.tell():
            return "the file was truncated; it is read from its start"
        return ""

    def write(self, data: bytes) -> None:
        """Ignored: a file cannot be answered."""

    def hang_up(self) -> None:
        """Ignored: a growing file may become good again."""

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
        self._file = None


class Connection:
    """A connection that is tried again, at longer and longer intervals, when lost.

    Attributes:
        socket: none while it is lost.
        due: time on the monotonic clock before which it is not tried again [s].
    """

    def __init__(self, host: str, port: int, patience: float = LONGEST_WAIT) -> None:
        self.address, self.patience = (host, port), patience
        self.socket: socket.socket | None = None
        self.due, self._wait = 0.0, FIRST_WAIT

    def open(self) -> None:
        """Connect if it is lost, and due."""
        if self.socket is not None or time.monotonic() < self.due:
            return
        try:
            self.socket = socket.create_connection(self.address, self.patience)
        except OSError:
            self.lose()
            return
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._wait = FIRST_WAIT

    def send(self, data: bytes) -> None:
        """Send bytes; they are dropped while it is lost, for commands age."""
        try:
            if self.socket is not None:
                self.socket.sendall(data)
        except OSError:
            self.lose()

    def lose(self) -> None:
        """Close it, to be tried again later."""
        self.close()
        self.due = time.monotonic() + self._wait
        self._wait = min(2 * self._wait, LONGEST_WAIT)

    def close(self) -> None:
        """Release the socket."""
        if self.socket is not None:
            self.socket.close()
        self.socket = None


class SocketSource(AbstractSource):
    """A rig that serves a socket; when it closes, it is tried again and again."""

    def __init__(self, host: str, port: int) -> None:
        self.connection = Connection(host, port)

    def read(self, wait: float) -> Reading:
        if (peer := self.connection.socket) is None:
            return self._connect(wait)
        ready, _, _ = select.select([peer], [], [], wait)
        if not ready:
            return Reading()
        try:
            data = peer.recv(CHUNK)
        except OSError:
            data = b""
        if data:
            return Reading(data)
        self.hang_up()
        return Reading(fresh=True, text="the rig has closed the connection")

    def _connect(self, wait: float) -> Reading:
        self.connection.open()
        if self.connection.socket is None:
            ahead = max(self.connection.due - time.monotonic(), 0.0)
            time.sleep(min(wait, ahead))
            return Reading()
        host, port = self.connection.address
        return Reading(fresh=True, text=f"connected to {host}:{port}")

    def write(self, data: bytes) -> None:
        self.connection.send(data)

    def hang_up(self) -> None:
        self.connection.lose()

    def close(self) -> None:
        self.connection.close()


class StreamSource(AbstractSource):
    """Standard input, or another pipe, until its end."""

    def __init__(self, descriptor: int = 0) -> None:
        self.descriptor = descriptor

    def read(self, wait: float) -> Reading:
        ready, _, _ = select.select([self.descriptor], [], [], wait)
        if not ready:
            return Reading()
        data = os.read(self.descriptor, CHUNK)
        return Reading(data) if data else Reading(ended=True)

    def write(self, data: bytes) -> None:
        """Ignored: standard input cannot be answered."""

    def hang_up(self) -> None:
        """Ignored: what is piped may become good again."""

    def close(self) -> None:
        """Ignored: the stream belongs to the process."""


LOOPBACK = ("127.0.0.1", "localhost", "::1")
"""Addresses that only this machine can reach."""


def address_of(text: str, token: str) -> tuple[str, int] | None:
    """Host and port of tcp://HOST:PORT; none where it is no such address.

    Raises:
        InputError: the address is damaged, or is not of this machine without a token.
    """
    scheme, separator, rest = text.partition("://")
    if not separator:
        return None
    host, _, port = rest.rpartition(":")
    if scheme != "tcp" or not host or not port.isdecimal() or int(port) > 65535:
        raise InputError(f"expected tcp://HOST:PORT, got {text!r}")
    host = host.strip("[]")
    if host not in LOOPBACK and not token:
        raise InputError(
            f"{text}: another machine needs a shared secret; give its file by --token"
        )
    return host, int(port)


def source_of(text: str, token: str = "") -> AbstractSource:
    """The source that an argument of the command line names.

    Raises:
        InputError: it is no usable address.
    """
    if text == "-":
        return StreamSource()
    address = address_of(text, token)
    return FileSource(Path(text)) if address is None else SocketSource(*address)


class FileSink(AbstractSink):
    """The end of a file; each line is there when the call returns."""

    def __init__(self, path: Path) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND
        self._descriptor = os.open(path, flags, 0o644)

    def write(self, data: bytes) -> None:
        os.write(self._descriptor, data)


class SocketSink(AbstractSink):
    """Another connection."""

    def __init__(self, host: str, port: int) -> None:
        self.connection = Connection(host, port, patience=0.2)

    def write(self, data: bytes) -> None:
        self.connection.open()
        self.connection.send(data)


def sink_of(text: str | None, source: AbstractSource, token: str = "") -> AbstractSink:
    """The sink that an argument names; the source by default."""
    if text is None:
        return source
    address = address_of(text, token)
    return FileSink(Path(text)) if address is None else SocketSink(*address)
