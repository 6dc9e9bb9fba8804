"""Lines for a terminal, and the page in a browser of this machine.

It is served on the loopback alone, by the standard library. It shows text as text,
asks for nothing from elsewhere, and cannot command anything.
"""

import base64
import contextlib
import hashlib
import http.server
import importlib.resources
import threading
from collections import deque
from collections.abc import Callable, Iterator
from typing import ClassVar

import msgspec

from pinav.live.messages import Command, Event, FromPinav, Ready, State, encode

STATUS_EVERY = 1.0
"""Seconds of the rig's clock between two lines for people."""


class EventPrinter:
    """Prints what is said."""

    def __init__(self, write: Callable[[str], object], *, people: bool = False) -> None:
        self.write = write
        self.people = people
        self._last: float | None = None

    def show(self, answer: FromPinav) -> None:
        """Print an answer, if it is one of those that are printed."""
        text = self._for_people(answer) if self.people else encode(answer).decode()
        if text:
            self.write(text)

    def _for_people(self, answer: FromPinav) -> str:
        if isinstance(answer, Event):
            return f"{_clock(answer.t)}  ! {answer.kind}: {answer.text}\n"
        if not isinstance(answer, State):
            return ""
        if self._last is not None and 0 <= answer.t - self._last < STATUS_EVERY:
            return ""
        self._last = answer.t
        return f"{status_line(answer)}\n"


def status_line(state: State) -> str:
    """The beliefs in a line."""
    parts = [f"{_clock(state.t)}  {state.mode:<11}"]
    if state.x is not None and state.y is not None:
        sd = "" if state.sd is None else f" ± {state.sd:.2g}"
        parts.append(f"at ({state.x:.4g}, {state.y:.4g}){sd}")
    if state.gain is not None and state.gain_sd is not None:
        parts.append(f"gain {state.gain:.3g} ± {state.gain_sd:.1g}")
    if state.offset is not None and state.delay is not None:
        parts.append(f"offset {state.offset:.2f} rad, delay {state.delay:.2f} s")
    if state.drift is not None:
        parts.append(f"drift ({state.drift[0]:.2g}, {state.drift[1]:.2g})")
    if state.force is not None:
        parts.append(f"force ({state.force[0]:.2g}, {state.force[1]:.2g})")
    if state.time_to_go is not None:
        parts.append(f"{state.time_to_go:.1f} s to go")
    return "  ".join(parts)


def _clock(t: float | None) -> str:
    return "        -" if t is None else f"{t:8.1f}s"


HOST = "127.0.0.1"
"""Nobody else can reach it."""

KEPT = 5000
"""Lines that a browser gets which comes late."""

PATIENCE = 10.0
"""Seconds after which a silent stream says that it lives."""


class Places(msgspec.Struct, frozen=True):
    """Goal (none if only watched), and centre and radius of each forbidden disc."""

    goal: tuple[float, ...] | None = None
    keep_out: tuple[tuple[float, ...], ...] = ()


class Lines:
    """The last lines, for any number of browsers that read at their own pace."""

    def __init__(self) -> None:
        self._lines: deque[bytes] = deque(maxlen=KEPT)
        self._count = 0
        self._closed = False
        self._changed = threading.Condition()

    def add(self, line: bytes) -> None:
        """One more line."""
        with self._changed:
            self._lines.append(line)
            self._count += 1
            self._changed.notify_all()

    def close(self) -> None:
        """Let everybody go who waits."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def after(self, count: int, wait: float) -> tuple[list[bytes], int, bool]:
        """Lines after so many, their number so far, and whether there may be more."""
        with self._changed:
            if self._count == count and not self._closed:
                self._changed.wait(wait)
            new = min(self._count - count, len(self._lines))
            lines = list(self._lines)[len(self._lines) - new :]
            return lines, self._count, not self._closed


class Page:
    """A page that is being served."""

    def __init__(self, server: http.server.ThreadingHTTPServer, lines: Lines) -> None:
        self.address = f"http://{HOST}:{server.server_address[1]}/"
        self._lines = lines

    @classmethod
    @contextlib.contextmanager
    def serve(cls, port: int, places: Places) -> Iterator["Page"]:
        """Serve a page until the context ends.

        Raises:
            OSError: the port is taken.
        """
        lines = Lines()
        handler = type("PageHandler", (_Handler,), {"lines": lines, "places": places})
        server = http.server.ThreadingHTTPServer((HOST, port), handler)
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield cls(server, lines)
        finally:
            lines.close()
            server.shutdown()
            server.server_close()

    def show(self, answer: FromPinav) -> None:
        """Pass an answer on to every browser; commands are in the states."""
        if not isinstance(answer, Command | Ready):
            self._lines.add(encode(answer))


def document(places: Places) -> tuple[bytes, str]:
    """The page, and the policy that lets it run its own script alone."""
    text = importlib.resources.files("pinav.live").joinpath("page.html").read_text()
    data = msgspec.json.encode(places).decode().replace("<", "\\u003c")
    page = text.replace("{{places}}", data)
    scripts = [part.split("</script>")[0] for part in page.split("<script>")[1:]]
    allowed = " ".join(map(_digest, scripts))
    style = _digest(page.split("<style>")[1].split("</style>")[0])
    policy = (
        f"default-src 'none'; script-src {allowed}; style-src {style}; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; "
        "frame-ancestors 'none'"
    )
    return page.encode(), policy


def _digest(text: str) -> str:
    digest = hashlib.sha256(text.encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"


class _Handler(http.server.BaseHTTPRequestHandler):
    """Two addresses: the page, and the stream of lines that it listens to."""

    lines: ClassVar[Lines]
    places: ClassVar[Places]

    def do_GET(self) -> None:
        # A page from elsewhere can send a browser here under another name.
        host = (self.headers.get("Host") or "").rsplit(":", 1)[0]
        if host not in (HOST, "localhost"):
            self.send_error(403)
        elif self.path == "/":
            self._send_page()
        elif self.path == "/events":
            with contextlib.suppress(OSError):  # the browser has gone
                self._stream()
        else:
            self.send_error(404)

    def _send_page(self) -> None:
        body, policy = document(self.places)
        self.send_response(200)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Content-Security-Policy", policy)
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(body)

    def _stream(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/event-stream")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        count, more = 0, True
        while more:
            lines, count, more = self.lines.after(count, PATIENCE)
            data = b"".join(b"data: " + line + b"\n" for line in lines)
            self.wfile.write(data or b": still here\n\n")

    def log_message(self, format: str, *args: object) -> None:
        """Ignored: requests are no events of a session."""
