"""Options of `pinav design`; imports no numerical library."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from pinav.commands.navigate.settings import NavigateSettings
from pinav.commands.places import numbers
from pinav.commands.settings import Range, RunOptions, Settings
from pinav.errors import InputError

DesignName = Literal["informed", "random", "grid"]


class DesignSettings(Settings, frozen=True):
    """What is to be known, and how trajectories are recorded.

    Attributes:
        start: Where the way begins.
        goal: Where it should end.
        tolerance: Distance from the goal that counts as there.
        thrust: Greatest thrust: an acceleration where the model has inertia, else a
            force. A swimmer whose propulsion takes frequency and heading has its own.
        frequency: Greatest frequency commanded, of a swimmer whose propulsion takes
            frequency and heading [Hz].
        keep_out: Discs that must not be entered.
        arena: Rectangle that must not be left; around start and goal unless given.
        release: Rectangle in which swimmers can be released; the arena unless given.
        time_limit: Longest time for the way.
        step: Time between two frames, and how long a command holds.
        duration: Length of a trajectory in time.
        noise: White noise of the swimmer: it adds noise * sqrt(dt) to the velocity,
            or to the position where there is no inertia.
        position_noise: Standard deviation of the observed positions.
        accuracy: Relative error of the force along the way that is small enough.
        most: Trajectories after which a campaign is given up.
        designs: Simulation: ways to choose trajectories, to be compared.
        seeds: Simulation: campaigns of each design, each with its own noise.
        seed: Seed of all noise and choices.
    """

    start: Annotated[str | None, tyro.conf.arg(name="from", metavar="X,Y")] = None
    goal: Annotated[str | None, tyro.conf.arg(name="to", metavar="X,Y")] = None
    tolerance: Annotated[float, Range(above=0)] = 0.3
    thrust: Annotated[float, Range(above=0)] = 0.8
    frequency: Annotated[float, Range(above=0)] = 10.0
    keep_out: Annotated[tuple[str, ...], tyro.conf.arg(metavar="X,Y,R")] = ()
    arena: Annotated[str | None, tyro.conf.arg(metavar="X0,Y0,X1,Y1")] = None
    release: Annotated[str | None, tyro.conf.arg(metavar="X0,Y0,X1,Y1")] = None
    time_limit: Annotated[float, Range(above=0)] = 20.0
    step: Annotated[float, Range(above=0)] = 0.1
    duration: Annotated[float, Range(above=0)] = 5.0
    noise: Annotated[float, Range(0)] = 0.1
    position_noise: Annotated[float, Range(above=0)] = 0.02
    accuracy: Annotated[float, Range(above=0, below=1)] = 0.1
    most: Annotated[int, Range(1)] = 24
    designs: tuple[DesignName, ...] = ("informed", "random", "grid")
    seeds: Annotated[int, Range(1)] = 4
    seed: int = 0

    def check_together(self) -> None:
        self.task_settings().check()
        self.task_settings().places()
        self.release_box()
        if not self.designs:
            raise InputError("--designs: expected at least one, such as informed")
        if self.duration < 2 * self.step:
            raise InputError(
                f"--duration: expected two steps or more, got {self.duration:g} with "
                f"--step {self.step:g}"
            )

    def task_settings(self) -> NavigateSettings:
        """The same task as that of `pinav navigate`."""
        return NavigateSettings(
            start=self.start,
            goal=self.goal,
            tolerance=self.tolerance,
            thrust=self.thrust,
            frequency=self.frequency,
            keep_out=self.keep_out,
            arena=self.arena,
            time_limit=self.time_limit,
            step=self.step,
            noise=self.noise,
        )

    def release_box(self) -> tuple[float, ...] | None:
        """Corners of the rectangle in which swimmers can be released.

        Raises:
            InputError: they are no rectangle.
        """
        if self.release is None:
            return None
        box = numbers("--release", self.release, 4)
        if not (box[0] < box[2] and box[1] < box[3]):
            raise InputError(
                f"--release: expected X0,Y0,X1,Y1 with X0 < X1 and Y0 < Y1, got "
                f"{self.release}"
            )
        return box


class DesignOptions(RunOptions, frozen=True):
    """Choose which trajectories to record until the force along a way is known.

    After each trajectory the force is learned from noisy positions, the way from a
    place to a place is planned on it, and the next trajectory is the one after which
    the force along that way should be known best. It ends when the relative error is
    below --accuracy with a probability of 95 %. With --data, the recordings of a lab,
    the run says whether they suffice and writes the commands of the next trajectory to
    next.csv. Without, the true environment of the system is used to simulate
    recordings, and designs are compared. A negative number takes an equals sign:
    --from=-1,2.

    Attributes:
        system: A system file (.toml), module.py:name, or the name of a built-in system.
        data: Trajectories that were recorded so far; files of pinav or of a tracker.
    """

    system: tyro.conf.Positional[str]
    data: tuple[Path, ...] = ()
    settings: DesignSettings = DesignSettings()
