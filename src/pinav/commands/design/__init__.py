"""Options of `pinav design`; imports no numerical library."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from pinav.commands.settings import Numbers, Range, RunOptions, Several, numbers
from pinav.commands.steering_settings import SteeringSettings
from pinav.errors import InputError

DesignName = Literal["informed", "random", "grid"]


class DesignSettings(SteeringSettings, frozen=True):
    """The quantity to be known, and the recording of trajectories.

    Attributes:
        release: Rectangle in which swimmers can be released; the arena unless given.
        duration: Length of a trajectory in time.
        position_noise: Standard deviation of the observed positions.
        accuracy: Relative error of the force along the way that is small enough.
        most: Trajectories after which a campaign is given up.
        designs: Simulation: ways to choose trajectories, to be compared.
        seeds: Simulation: campaigns of each design, each with its own noise.
    """

    release: Annotated[
        str | None, Numbers((4,)), tyro.conf.arg(metavar="X0,Y0,X1,Y1")
    ] = None
    duration: Annotated[float, Range(above=0)] = 5.0
    position_noise: Annotated[float, Range(above=0)] = 0.02
    accuracy: Annotated[float, Range(above=0, below=1)] = 0.1
    most: Annotated[int, Range(1)] = 24
    designs: Annotated[tuple[DesignName, ...], Several()] = (
        "informed",
        "random",
        "grid",
    )
    seeds: Annotated[int, Range(1)] = 4

    def release_box(self) -> tuple[float, ...] | None:
        """Corners of the rectangle in which swimmers can be released."""
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
