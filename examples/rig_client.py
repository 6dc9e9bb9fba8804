"""A rig's side of `pinav live`, in plain Python: copy this file to the rig's computer.

It needs nothing but Python 3.9. `Rig` serves one pinav on a socket; it keeps the last
command and forgets it when its time is over, so that the robot stops by itself whatever
becomes of pinav. docs/live.md describes the lines.

    rig = Rig("127.0.0.1", 5005, session="monday", step=0.1, frequency=10.0)
    while tracking:
        x, y = position_of_robot()  # or None, None
        frequency, heading = rig.command(t)
        apply_field(frequency, heading)
        rig.frame(t, x, y, frequency, heading)
    rig.close("end of the day")

Run it (`python examples/rig_client.py 300`) to serve a simulated robot for so many
seconds, one unless given, and in another terminal
`pinav live tcp://127.0.0.1:5005 --to 200,100 --status`.
"""

import json
import math
import random
import select
import socket
import sys
import time

VERSION = 1
LONGEST = 64 * 1024


class Rig:
    """Serves frames to one pinav at a time, and hears its commands."""

    def __init__(self, host, port, *, session, step, frequency, units="um", token=""):
        self.hello = {
            "type": "hello",
            "version": VERSION,
            "session": session,
            "step": step,
            "units": units,
            "limits": {"frequency": frequency},
            "token": token,
        }
        self.server = socket.create_server((host, port))
        self.address = self.server.getsockname()
        self.peer = None
        self.half = b""
        self.last = (0.0, 0.0, -math.inf)  # frequency, heading, valid until
        self.seq = 0  # of the next frame
        self.answered = -1  # frame that the last command answers

    def command(self, t):
        """Frequency [Hz] and heading [rad] to apply at time t [s]."""
        self._listen()
        frequency, heading, valid_until = self.last
        return (frequency, heading) if t <= valid_until else (0.0, heading)

    def frame(self, t, x, y, frequency, heading, sd=None):
        """Tell where the robot is, and what is applied from t on."""
        frame = {"type": "frame", "seq": self.seq, "t": t, "x": x, "y": y, "sd": sd}
        self.seq += 1
        self._send({**frame, "frequency": frequency, "heading": heading})

    def close(self, reason=""):
        """End the session."""
        self._send({"type": "bye", "reason": reason})
        self._drop()
        self.server.close()

    def _listen(self):
        """Take what has come, without waiting."""
        watched = [self.server] if self.peer is None else [self.server, self.peer]
        ready, _, _ = select.select(watched, [], [], 0.0)
        if self.server in ready:
            self._drop()
            self.peer, _ = self.server.accept()
            self.peer.settimeout(1.0)
            self._send(self.hello)
        elif self.peer in ready:
            try:
                data = self.peer.recv(LONGEST)
            except OSError:
                data = b""
            if not data:
                self._drop()
            *lines, self.half = (self.half + data).split(b"\n")
            self.half = self.half[:LONGEST]
            for line in lines:
                self._take(line)

    def _take(self, line):
        """Keep a command; anything else, and anything damaged, is for people."""
        try:
            message = json.loads(line)
            if message["type"] == "command":
                names = ("frequency", "heading", "valid_until")
                values = tuple(float(message[name]) for name in names)
                most = self.hello["limits"]["frequency"]
                if all(map(math.isfinite, values)) and 0 <= values[0] <= most:
                    self.last, self.answered = values, int(message["seq"])
        except (ValueError, KeyError, TypeError):
            pass

    def _send(self, message):
        if self.peer is None:
            return
        try:
            self.peer.sendall(json.dumps(message, allow_nan=False).encode() + b"\n")
        except OSError:
            self._drop()

    def _drop(self):
        if self.peer is not None:
            self.peer.close()
        self.peer, self.half = None, b""


def main(seconds):
    """Serve a simulated robot in real time."""
    rig = Rig("127.0.0.1", 5005, session="demo", step=0.1, frequency=3.0)
    print(f"serving a simulated robot on {rig.address[0]}:{rig.address[1]}")
    x, y, t, pending = 0.0, 0.0, 0.0, [(0.0, 0.0)] * 3
    begin = time.monotonic()
    while t < seconds:
        frequency, heading = rig.command(t)
        noise = random.gauss(0.0, 0.3), random.gauss(0.0, 0.3)
        rig.frame(t, x + noise[0], y + noise[1], frequency, heading)
        pending.append((frequency, heading))
        acting, angle = pending.pop(0)
        x += 0.1 * (9.0 * acting * math.cos(angle + 1.4) + 0.3)
        y += 0.1 * (9.0 * acting * math.sin(angle + 1.4) - 0.2)
        t += 0.1
        time.sleep(max(begin + t - time.monotonic(), 0.0))


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 1.0)
