"""A simulated rig: a robot whose drive is known to nobody but this file.

`Robot` integrates the truth. `python tests/rig.py --help` is a process that tells its
frames by a growing file or by the client of the examples over a socket, obeys commands
after a delay, and logs the truth where pinav does not look. Faults are options.
"""

import argparse
import dataclasses
import json
import math
import os
import random
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))

from rig_client import Rig


@dataclasses.dataclass
class Robot:
    """A roller: velocity gain * f at an angle to the heading, and a drift.

    The response loses a part of the speed above its corner; commands act late.
    """

    gain: float = 9.0
    offset: float = 1.4
    drift: tuple[float, float] = (0.3, -0.2)
    corner: float = 2.0
    residual: float = 0.3
    noise: float = 0.3
    late: int = 3  # steps
    step: float = 0.1
    seed: int = 0

    def __post_init__(self):
        self.x, self.y, self.t = 0.0, 0.0, 0.0
        self.pending = [(0.0, 0.0)] * self.late
        self.random = random.Random(self.seed)

    def seen(self) -> tuple[float, float]:
        scatter = self.random.gauss(0, self.noise), self.random.gauss(0, self.noise)
        return self.x + scatter[0], self.y + scatter[1]

    def move(self, frequency: float, heading: float) -> None:
        self.pending.append((frequency, heading))
        f, angle = self.pending.pop(0)
        slip = f / math.sqrt(1 + (f / self.corner) ** 2)
        speed = self.gain * (self.residual * f + (1 - self.residual) * slip)
        angle += self.offset
        self.x += self.step * (speed * math.cos(angle) + self.drift[0])
        self.y += self.step * (speed * math.sin(angle) + self.drift[1])
        self.t += self.step


class FileRig:
    """Tells frames by a file that grows, and reads commands from another one."""

    def __init__(self, frames: Path, commands: Path, session: str, step: float):
        self.path, self.commands = frames, commands
        self.file = frames.open("ab", buffering=0)
        self.place, self.last, self.seq = 0, (0.0, 0.0, -math.inf), 0
        self.answered = -1
        limits = {"frequency": 3.0}
        self.hello = {"type": "hello", "version": 1, "session": session}
        self.hello |= {"step": step, "limits": limits}
        self.say(self.hello)

    def say(self, message: dict) -> None:
        self.write(json.dumps(message).encode() + b"\n")

    def write(self, data: bytes) -> None:
        self.file.write(data)

    def command(self, t: float) -> tuple[float, float]:
        if self.commands.exists():
            with open(self.commands, "rb") as file:
                file.seek(self.place)
                for line in file:
                    if not line.endswith(b"\n"):
                        break
                    self.place += len(line)
                    message = json.loads(line)
                    if message["type"] == "command":
                        names = ("frequency", "heading", "valid_until")
                        self.last = tuple(message[name] for name in names)
                        self.answered = message["seq"]
        frequency, heading, valid_until = self.last
        return (frequency, heading) if t <= valid_until else (0.0, heading)

    def frame(self, t, x, y, frequency, heading):
        frame = {"type": "frame", "seq": self.seq, "t": t, "x": x, "y": y}
        self.seq += 1
        self.say({**frame, "frequency": frequency, "heading": heading})

    def rotate(self) -> None:
        self.file.close()
        os.replace(self.path, self.path.with_suffix(".old"))
        self.file = self.path.open("ab", buffering=0)
        self.say(self.hello)

    def truncate(self) -> None:
        self.file.truncate(0)
        self.say(self.hello)

    def close(self, reason: str) -> None:
        self.say({"type": "bye", "reason": reason})
        self.file.close()


FAULTS = ("half", "garbage", "repeat", "back", "forward", "lost", "swap", "burst")
FAULTS += ("rotate", "truncate", "close")


FIRST, APART = 150, 14
"""Frame of the first kind of fault, and frames between two kinds."""


class Faults:
    """What goes wrong: one kind after the other, again and again."""

    def __init__(self, names: list[str], rig):
        self.names, self.rig, self.shift = set(names), rig, 0.0

    def due(self, name: str, seq: int, length: int = 1) -> bool:
        since = seq - FIRST - APART * FAULTS.index(name)
        period = APART * len(FAULTS)
        return name in self.names and since >= 0 and since % period < length

    def raw(self, data: bytes) -> None:
        if isinstance(self.rig, FileRig):
            self.rig.write(data)
        elif self.rig.peer is not None:
            self.rig.peer.sendall(data)

    def before(self, seq: int) -> None:
        if self.due("garbage", seq):
            self.raw(b'{"type": "frame", nonsense\n\xff\xfe\x00\n[[[[\n')
        if self.due("back", seq):
            self.shift -= 7.0
        if self.due("forward", seq):
            self.shift += 9.0
        if self.due("repeat", seq):
            self.rig.seq -= 5
        if self.due("rotate", seq):
            self.rig.rotate()
        if self.due("truncate", seq):
            self.rig.truncate()
        if self.due("close", seq):
            self.rig._drop()
        if self.due("half", seq):
            self.raw(b'{"type": "frame", ')
            time.sleep(0.05)
            self.raw(b'"seq": 0, "t": 0, "x": 0, "y": 0}\n')


PATIENCE = 0.5
"""Longest wait for the answer to a frame [s], so that load decides nothing."""


def pause(rig, t: float, pace: float, patience: float) -> None:
    """Let time pass after a frame, until it was answered if that is asked for."""
    time.sleep(pace)
    ends = time.monotonic() + patience
    while rig.answered < rig.seq - 1 and time.monotonic() < ends:
        rig.command(t)
        time.sleep(0.002)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--file", type=Path)
    parser.add_argument("--commands", type=Path)
    parser.add_argument("--port", type=int, default=0)
    parser.add_argument("--truth", type=Path, required=True)
    parser.add_argument("--frames", type=int, default=400)
    parser.add_argument("--pace", type=float, default=0.01, help="seconds a frame")
    parser.add_argument("--wait", action="store_true", help="for answers")
    parser.add_argument("--fault", action="append", default=[], choices=FAULTS)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    robot = Robot(seed=given.seed)
    if given.file:
        rig = FileRig(given.file, given.commands, "test", robot.step)
    else:
        rig = Rig("127.0.0.1", given.port, session="test", step=0.1, frequency=3.0)
        print(rig.address[1], flush=True)
        while rig.peer is None:
            rig.command(0.0)
            time.sleep(0.01)
    while given.file and not given.commands.exists():
        time.sleep(0.01)  # pinav has not started yet
    faults = Faults(given.fault, rig)
    truth = given.truth.open("w", buffering=1)
    for count in range(given.frames):
        faults.before(count)
        t = robot.t + faults.shift
        frequency, heading = rig.command(t)
        x, y = robot.seen()
        if faults.due("swap", count, 3):
            x, y = x + 300, y - 200
        if faults.due("lost", count, 12) or faults.due("swap", count - 1, 1):
            x = y = None
        rig.frame(t, x, y, frequency, heading)
        row = [count, robot.t, robot.x, robot.y, frequency, heading]
        truth.write(json.dumps(row) + "\n")
        robot.move(frequency, heading)
        if not faults.due("burst", count, 15):
            pause(rig, t, given.pace, PATIENCE if given.wait else 0.0)
    time.sleep(0.3)
    rig.close("end of the test")


if __name__ == "__main__":
    main()
