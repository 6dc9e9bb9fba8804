"""Settings of `pinav navigate`; imports no numerical library."""

from pathlib import Path
from typing import Annotated

import tyro

from pinav.commands.places import numbers
from pinav.commands.settings import Range, RunOptions, Settings
from pinav.errors import InputError


class NavigateSettings(Settings, frozen=True):
    """Where to go, with which swimmer, and how it is tried.

    Attributes:
        start: Where the run begins.
        goal: Where it should end.
        tolerance: Distance from the goal that counts as there.
        thrust: Greatest thrust: an acceleration where the model has inertia, else a
            force. A recording's robot has its own.
        keep_out: Discs that must not be entered.
        arena: Rectangle that must not be left; around data, start and goal unless
            given.
        step: How long a command holds.
        time_limit: When a run has failed; also horizon of the plan.
        noise: White noise of the true swimmer: it adds noise * sqrt(dt) to the
            velocity, or to the position where there is no inertia.
        sensor_noise: Error of what the controller is told of the state.
        delay: From command to motion; that of the system's propulsion unless given.
        samples: Models drawn from the posterior, whose spread makes uncertain regions
            cost more; 0 takes the model for true.
        seeds: Runs of each controller, each with its own noise.
        seed: Seed of all noise.
        frequency: Recording: greatest frequency commanded [Hz].
    """

    start: Annotated[str, tyro.conf.arg(name="from", metavar="X,Y")]
    goal: Annotated[str, tyro.conf.arg(name="to", metavar="X,Y")]
    tolerance: Annotated[float, Range(above=0)] = 0.3
    thrust: Annotated[float, Range(above=0)] = 0.8
    keep_out: Annotated[tuple[str, ...], tyro.conf.arg(metavar="X,Y,R")] = ()
    arena: Annotated[str | None, tyro.conf.arg(metavar="X0,Y0,X1,Y1")] = None
    step: Annotated[float, Range(above=0)] = 0.1
    time_limit: Annotated[float, Range(above=0)] = 20.0
    noise: Annotated[float, Range(0)] = 0.1
    sensor_noise: Annotated[float, Range(0)] = 0.0
    delay: Annotated[float | None, Range(0)] = None
    samples: int = 8
    seeds: Annotated[int, Range(1)] = 20
    seed: int = 0
    frequency: Annotated[float, Range(above=0)] = 10.0

    def check_together(self) -> None:
        if self.samples < 0 or self.samples == 1:
            raise InputError(
                f"--samples: expected 0, or 2 and more, got {self.samples}"
            )
        self.places()

    def places(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Start and goal."""
        self.discs()
        self.box()
        return numbers("--from", self.start, 2), numbers("--to", self.goal, 2)

    def discs(self) -> list[tuple[float, ...]]:
        """Centre and radius of each disc that must not be entered."""
        return [numbers("--keep-out", text, 3) for text in self.keep_out]

    def box(self) -> tuple[float, ...] | None:
        """Corners of the arena."""
        return None if self.arena is None else numbers("--arena", self.arena, 4)


class NavigateOptions(RunOptions, frozen=True):
    """Go from a place to a place through the force that a run has learned.

    Plans on the learned force (from where the goal cannot be reached, and where the
    model is uncertain), steers by model-predictive control, and tries it in closed
    loop: in the true environment where the data are those of a scenario, else in
    environments drawn from the posterior. Physics alone and, where it is known, the
    same controller with the truth are tried beside it. The run also suggests the
    trajectory that would tell most about the force along the route. Writes
    metrics.json, report.html, figures and an animation. A negative number takes an
    equals sign: --from=-1,2.

    Attributes:
        run: Folder of pinav fit, of trajectories or of a recording.
    """

    run: tyro.conf.Positional[Path]
    settings: NavigateSettings
