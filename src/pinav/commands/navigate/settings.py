"""Settings of `pinav navigate`; imports no numerical library."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from pinav.commands.places import numbers
from pinav.commands.settings import Range, RunOptions, Settings
from pinav.errors import InputError


class NavigateSettings(Settings, frozen=True):
    """Where to go, with which swimmer, and how it is tried.

    Attributes:
        start: Where the run begins: X,Y, or X,Y,Z where the run's data have a z.
        goal: Where it should end.
        tolerance: Distance from the goal that counts as there.
        thrust: Greatest thrust: an acceleration where the model has inertia, else a
            force. A recording's robot has its own.
        keep_out: Discs, or balls X,Y,Z,R, that must not be entered.
        arena: Rectangle, or box X0,Y0,Z0,X1,Y1,Z1, that must not be left; around
            data, start and goal unless given.
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

    start: Annotated[str | None, tyro.conf.arg(name="from", metavar="X,Y")] = None
    goal: Annotated[str | None, tyro.conf.arg(name="to", metavar="X,Y")] = None
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
        self.discs()
        self.box()
        for name, place in (("--from", self.start), ("--to", self.goal)):
            if place is not None:
                numbers(name, place, 2, 3)

    def places(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Start and goal.

        Raises:
            InputError: one of them is missing, or is no place.
        """
        if self.start is None or self.goal is None:
            raise InputError(
                "--from, --to: expected the places where the way begins and ends, such "
                "as --from 0.5,1 --to 9.5,9.5"
            )
        start, goal = self.start, self.goal
        return numbers("--from", start, 2, 3), numbers("--to", goal, 2, 3)

    def check_dimension(self, dim: int) -> None:
        """Refuse places that have not as many coordinates as the run's data.

        Raises:
            InputError: a place, disc or arena has another number.
        """
        box = () if self.arena is None else (("--arena", self.arena, 2 * dim),)
        given = [("--from", self.start, dim), ("--to", self.goal, dim), *box]
        given += [("--keep-out", text, dim + 1) for text in self.keep_out]
        for name, text, count in given:
            if text is not None:
                numbers(name, text, count)

    def discs(self) -> list[tuple[float, ...]]:
        """Centre and radius of each disc that must not be entered."""
        return [numbers("--keep-out", text, 3, 4) for text in self.keep_out]

    def box(self) -> tuple[float, ...] | None:
        """Corners of the arena."""
        return None if self.arena is None else numbers("--arena", self.arena, 4, 6)


StrategyName = Literal["certain", "averse", "curious", "doubted", "sampled"]


class OnlineSettings(Settings, frozen=True):
    """How a task is done without any data beforehand.

    Attributes:
        learn_online: Learn the force while steering; needs --task and no run.
        task: Name of a task, such as barrier-weak.
        strategy: What a plan makes of what is not known: takes the mean for true,
            avoids it, seeks it, expects stronger forces there, or takes draws for true.
        position_noise: Standard deviation of the observed positions.
        visits: How often each swimmer does the task, with the map kept.
    """

    learn_online: bool = False
    task: str | None = None
    strategy: StrategyName = "curious"
    position_noise: Annotated[float, Range(above=0)] = 0.02
    visits: Annotated[int, Range(1)] = 2

    def check_together(self) -> None:
        if self.learn_online != (self.task is not None):
            raise InputError(
                "--learn-online and --task: expected both or none of them, such as "
                "--learn-online --task barrier-weak"
            )


class NavigateOptions(RunOptions, frozen=True):
    """Go from a place to a place through the force that a run has learned.

    Plans on the learned force (from where the goal cannot be reached, and where the
    model is uncertain), steers by model-predictive control, and tries it in closed
    loop: in the true environment where the data are those of a scenario, else in
    environments drawn from the posterior. Physics alone and, where it is known, the
    same controller with the truth are tried beside it. The run also suggests the
    trajectory that would tell most about the force along the route. Writes
    metrics.json, report.html, figures and an animation. A negative number takes an
    equals sign: --from=-1,2. With --learn-online there is no run: the force of a named
    task is learned on the way, from noisy positions alone.

    Attributes:
        run: Folder of pinav fit, of trajectories or of a recording; none with
            --learn-online.
    """

    run: tyro.conf.Positional[Path | None] = None
    settings: NavigateSettings = NavigateSettings()
    online: OnlineSettings = OnlineSettings()

    def check_together(self) -> None:
        if self.online.learn_online:
            if self.run is not None or self.settings.start or self.settings.goal:
                raise InputError(
                    "--learn-online: expected no run, --from or --to, for the task has "
                    "its own places; leave them out"
                )
        elif self.run is None:
            raise InputError(
                "RUN: expected the folder of a fit, or --learn-online with --task"
            )
        else:
            self.settings.places()
