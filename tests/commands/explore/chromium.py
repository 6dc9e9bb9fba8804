"""A headless Chromium, driven over the pipe of its DevTools protocol."""

import json
import os
import shutil
import subprocess
import tempfile
import time

NAMES = ("chromium", "chromium-browser", "google-chrome")

QUIET = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update"),
    *("--disable-dev-shm-usage", "--hide-scrollbars", "--mute-audio"),
)


def find_chromium() -> str | None:
    """The program, where it is installed."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Chromium:
    """One browser with one page; messages end with a zero byte, both ways."""

    def __init__(self, timeout: float = 60.0):
        self.folder = tempfile.mkdtemp(prefix="pinav-chromium-")
        self.timeout = timeout
        to_read, self.to_browser = os.pipe()
        self.from_browser, to_write = os.pipe()

        # The shell puts the pipes where the browser looks, because a function between
        # fork and exec would be Python in the child of a process with many threads.
        wiring = f'exec "$@" 3<&{to_read} 4>&{to_write}'
        self.process = subprocess.Popen(
            [
                *("bash", "-c", wiring, "bash", str(find_chromium()), *QUIET),
                *("--remote-debugging-pipe", f"--user-data-dir={self.folder}"),
            ],
            pass_fds=(to_read, to_write),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(to_read)
        os.close(to_write)
        self.count, self.rest, self.session = 0, b"", None
        self.events: list[dict] = []
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        attached = self.send("Target.attachToTarget", targetId=target, flatten=True)
        self.session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.send(f"{domain}.enable")

    def send(self, method: str, **params):
        """Call a method of the protocol and wait for what it returns."""
        self.count += 1
        message = {"id": self.count, "method": method, "params": params}
        if self.session:
            message["sessionId"] = self.session
        os.write(self.to_browser, json.dumps(message).encode() + b"\0")
        while True:
            answer = self.receive()
            if answer.get("id") == self.count:
                assert "error" not in answer, f"{method}: {answer['error']}"
                return answer["result"]

    def receive(self) -> dict:
        while b"\0" not in self.rest:
            piece = os.read(self.from_browser, 2**20)
            assert piece, "the browser has gone"
            self.rest += piece
        message, _, self.rest = self.rest.partition(b"\0")
        answer = json.loads(message)
        if "method" in answer:
            self.events.append(answer)
        return answer

    def open(self, address: str, *, width: int = 1200, height: int = 900) -> None:
        """Load a page at a size; waits until it is loaded."""
        self.resize(width, height)
        self.events.clear()
        self.send("Page.navigate", url=address)
        self.wait_for("document.readyState === 'complete'")

    def resize(self, width: int, height: int = 900) -> None:
        """A viewport of this width, which may be less than a window's least."""
        size = {"width": width, "height": height}
        self.send(
            "Emulation.setDeviceMetricsOverride",
            **size,
            deviceScaleFactor=1,
            mobile=width < 600,
        )

    def run(self, expression: str):
        """The value of an expression, or of the promise that it gives."""
        answer = self.send(
            "Runtime.evaluate",
            expression=expression,
            awaitPromise=True,
            returnByValue=True,
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait_for(self, condition: str, seconds: float = 30.0) -> None:
        """Wait until an expression is true."""
        end = time.monotonic() + seconds
        while not self.run(condition):
            assert time.monotonic() < end, f"not within {seconds} s: {condition}"
            time.sleep(0.02)

    def named(self, method: str) -> list[dict]:
        """Parameters of the events of this name since the page was opened."""
        return [e["params"] for e in self.events if e["method"] == method]

    def check_quiet(self, *more: str) -> None:
        """Nothing was thrown or logged since the page was opened, nor these events."""
        for trouble in ("Runtime.exceptionThrown", "Log.entryAdded", *more):
            assert not self.named(trouble)

    def press(self, key: str, modifiers: int = 0) -> None:
        """Press and let go a key; modifiers: 2 is Control, 8 is Shift."""
        codes = {"Tab": 9, "Enter": 13, " ": 32, "ArrowLeft": 37, "ArrowUp": 38}
        codes |= {"ArrowRight": 39, "ArrowDown": 40}
        text = {"Enter": "\r", " ": " "}.get(key)
        common = {"key": key, "modifiers": modifiers}
        common["windowsVirtualKeyCode"] = codes.get(key, ord(key[0].upper()))
        down = {**common, **({"text": text} if text else {})}
        self.send("Input.dispatchKeyEvent", type="keyDown", **down)
        self.send("Input.dispatchKeyEvent", type="keyUp", **common)

    def mouse(self, kind: str, x: float, y: float, **more) -> None:
        """One event of the mouse: Pressed, Moved or Released."""
        at = {"x": x, "y": y, "button": "left", "buttons": 1, "clickCount": 1}
        self.send("Input.dispatchMouseEvent", type=f"mouse{kind}", **{**at, **more})

    def close(self) -> None:
        """End the browser."""
        self.session = None
        try:
            self.send("Browser.close")
        except (AssertionError, OSError):
            self.process.kill()
        self.process.wait(timeout=20)
        os.close(self.to_browser)
        os.close(self.from_browser)
        shutil.rmtree(self.folder, ignore_errors=True)
