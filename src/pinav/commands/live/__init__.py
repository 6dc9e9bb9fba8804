"""Options of `pinav live`; imports no numerical library."""

from pathlib import Path
from typing import Annotated

import tyro

from pinav.commands.settings import Numbers, Range, ReadingWords, Settings, numbers
from pinav.errors import InputError
from pinav.reading import PLAIN


class LiveSettings(Settings, frozen=True):
    """What is done at the rig.

    Attributes:
        to: Where the robot should go; nothing is commanded without it.
        tolerance: Distance from the goal that counts as there, in the units of the rig.
        keep_out: Discs that must not be entered.
        watch: Estimate, and command nothing whatever else is given.
        frequency: Greatest frequency of a robot whose table does not say it [Hz].
    """

    to: Annotated[str | None, Numbers((2,)), tyro.conf.arg(metavar="X,Y")] = None
    tolerance: Annotated[float, Range(above=0)] = 5.0
    keep_out: Annotated[
        tuple[str, ...], Numbers((3,)), tyro.conf.arg(metavar="X,Y,R")
    ] = ()
    watch: bool = False
    frequency: Annotated[float, Range(above=0)] = 10.0

    def check_together(self) -> None:
        discs, goal = self.discs(), self.goal()
        for x, y, radius in discs:
            if radius <= 0:
                raise InputError(f"--keep-out: expected a radius > 0, got {radius:g}")
            if goal and (goal[0] - x) ** 2 + (goal[1] - y) ** 2 <= radius**2:
                raise InputError(
                    f"--to: ({goal[0]:g}, {goal[1]:g}) lies in the forbidden disc "
                    f"{x:g},{y:g},{radius:g}"
                )

    def goal(self) -> tuple[float, ...] | None:
        """Where to go; none where nothing is commanded."""
        return None if self.to is None or self.watch else numbers("--to", self.to, 2)

    def discs(self) -> list[tuple[float, ...]]:
        """Centre and radius of each disc that must not be entered."""
        return [numbers("--keep-out", text, 3) for text in self.keep_out]


class LiveOptions(Settings, frozen=True, kw_only=True):
    """Estimate a robot while it is observed, and steer it to a goal.

    Reads the frames of a rig as lines of JSON, or a tracker's growing table, and writes
    what it believes after each frame, with commands where a goal is given. The protocol
    is documented, with a client for the rig's computer, in docs/live.md. A negative
    number takes an equals sign: --to=-1,2.

    Attributes:
        source: A file that grows, tcp://HOST:PORT of a rig that serves, or - for
            standard input.
        commands_to: Where commands go: a file, or tcp://HOST:PORT; the rig's own
            connection unless given.
        replay: Take a finished recording on its own clock; the same lines each time.
        speed: Replay so many times as fast as it was recorded; max by default.
        out: Folder for the checkpoint of each second.
        resume: Go on from the checkpoint in --out.
        prior: Folder (--out) of an earlier session with the same robot, whose drive is
            then known from the first frame on.
        token: File with the secret that a rig on another machine must know.
        page: Port of a page in the browser of this machine; none unless given.
        status: Print a line for people each second instead of lines of JSON.
        frames: End after so many frames.
    """

    source: tyro.conf.Positional[str]
    settings: LiveSettings = LiveSettings()
    commands_to: str | None = None
    replay: bool = False
    speed: str = "max"
    reading: ReadingWords = PLAIN
    out: Path | None = None
    resume: bool = False
    prior: Path | None = None
    token: Path | None = None
    page: Annotated[int | None, Range(above=-1, below=65536)] = None
    status: bool = False
    frames: Annotated[int | None, Range(1)] = None

    def check_together(self) -> None:
        if self.resume and (self.out is None or self.replay):
            raise InputError("--resume: needs the --out of a session that is no replay")
        if self.replay and self.commands_to is not None:
            raise InputError("--commands-to: nobody listens to a replay; drop it")
        self.rate()

    def rate(self) -> float | None:
        """Seconds of the recording in one second; none for as quick as can be."""
        if self.speed == "max":
            return None
        try:
            rate = float(self.speed)
        except ValueError:
            rate = 0.0
        if not 0 < rate < float("inf"):
            raise InputError(f"--speed: expected a number > 0 or max, got {self.speed}")
        return rate
