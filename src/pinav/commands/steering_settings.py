"""Where a swimmer is to go and how it is steered; imports no numerical library."""

from typing import Annotated

import tyro

from pinav.commands.settings import Numbers, Range, Settings, numbers
from pinav.errors import InputError


class SteeringSettings(Settings, frozen=True):
    """Where to go, with which swimmer.

    Attributes:
        start: Where the run begins; with a z where the swimmer moves in space.
        goal: Where it should end.
        tolerance: Distance from the goal that counts as there.
        thrust: Greatest thrust: an acceleration where the model has inertia, else a
            force. A swimmer whose propulsion takes frequency and heading has its own.
        keep_out: Discs, or balls X,Y,Z,R in space, that must not be entered.
        arena: Rectangle, or box X0,Y0,Z0,X1,Y1,Z1 in space, that must not be left;
            around data, start and goal unless given.
        step: How long a command holds.
        time_limit: When a run has failed; also horizon of the plan.
        noise: White noise of the true swimmer: it adds noise * sqrt(dt) to the
            velocity, or to the position where there is no inertia.
        delay: From command to motion; that of the system's propulsion unless given.
        frequency: Greatest frequency commanded, of a swimmer whose propulsion takes
            frequency and heading [Hz].
        seed: Seed of all noise.
    """

    start: Annotated[
        str | None, Numbers((2, 3), "--from"), tyro.conf.arg(name="from", metavar="X,Y")
    ] = None
    goal: Annotated[
        str | None, Numbers((2, 3), "--to"), tyro.conf.arg(name="to", metavar="X,Y")
    ] = None
    tolerance: Annotated[float, Range(above=0)] = 0.3
    thrust: Annotated[float, Range(above=0)] = 0.8
    keep_out: Annotated[
        tuple[str, ...], Numbers((3, 4)), tyro.conf.arg(metavar="X,Y,R")
    ] = ()
    arena: Annotated[
        str | None, Numbers((4, 6)), tyro.conf.arg(metavar="X0,Y0,X1,Y1")
    ] = None
    step: Annotated[float, Range(above=0)] = 0.1
    time_limit: Annotated[float, Range(above=0)] = 20.0
    noise: Annotated[float, Range(0)] = 0.1
    delay: Annotated[float | None, Range(0)] = None
    frequency: Annotated[float, Range(above=0)] = 10.0
    seed: int = 0

    def places(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Start and goal."""
        if self.start is None or self.goal is None:
            raise InputError(
                "--from, --to: expected the places where the way begins and ends, such "
                "as --from 0.5,1 --to 9.5,9.5"
            )
        start, goal = self.start, self.goal
        return numbers("--from", start, 2, 3), numbers("--to", goal, 2, 3)
