"""Settings of `pinav navigate`; imports no numerical library."""

from pathlib import Path
from typing import Annotated

import tyro

from pinav.commands.settings import Range, ResumableOptions, Settings
from pinav.commands.steering_settings import SteeringSettings
from pinav.commands.worker_settings import WorkerSettings
from pinav.errors import InputError


class NavigateSettings(SteeringSettings, frozen=True):
    """Where to go, with which swimmer, and how it is tried.

    Attributes:
        sensor_noise: Error of what the controller is told of the state.
        samples: Models drawn from the posterior, whose spread makes uncertain regions
            cost more; 0 takes the model for true.
        seeds: Runs of each controller, each with its own noise.
    """

    sensor_noise: Annotated[float, Range(0)] = 0.0
    samples: int = 8
    seeds: Annotated[int, Range(1)] = 20

    def check_together(self) -> None:
        if self.samples < 0 or self.samples == 1:
            raise InputError(
                f"--samples: expected 0, or 2 and more, got {self.samples}"
            )
        SteeringSettings.check_together(self)


class OnlineSettings(Settings, frozen=True):
    """How a task is done without any data beforehand.

    Attributes:
        learn_online: Learn the force while steering; needs no run, but --task or
            --system.
        task: Name of a task, such as barrier-weak, with places of its own.
        system: A system file, or the name of a built-in system, whose true environment
            the swimmer does not know; needs --from and --to.
        position_noise: Standard deviation of the observed positions.
        visits: How often each swimmer does the task, with the map kept.
    """

    learn_online: bool = False
    task: str | None = None
    system: str | None = None
    position_noise: Annotated[float, Range(above=0)] = 0.02
    visits: Annotated[int, Range(1)] = 2

    def check_together(self) -> None:
        worlds = [w for w in (self.task, self.system) if w is not None]
        if len(worlds) != self.learn_online:
            raise InputError(
                "--learn-online: expected it together with --task or with --system, "
                "such as --learn-online --task barrier-weak"
            )


class NavigateOptions(ResumableOptions, frozen=True, kw_only=True):
    """Go from a place to a place through the force that a run has learned.

    Plans on the learned force (from where the goal cannot be reached, and where the
    model is uncertain), steers by model-predictive control, and tries it in closed
    loop: in the true environment where the data are those of a scenario, else in
    environments drawn from the posterior. Physics alone and, where it is known, the
    same controller with the truth are tried beside it. The run also suggests the
    trajectory that would tell most about the force along the route. Writes
    metrics.json, report.html, figures and an animation. A negative number takes an
    equals sign: --from=-1,2. With --learn-online there is no run: the force of a named
    task, or of a system, is learned on the way, from noisy positions alone.

    Attributes:
        run: Folder of pinav fit, of trajectories or of a recording; none with
            --learn-online.
        prior: Folder of pinav fit, with a posterior: the force that it found is the
            first guess of --learn-online.
        workers: Who does the closed loops of all seeds.
    """

    run: tyro.conf.Positional[Path | None] = None
    settings: NavigateSettings = NavigateSettings()
    online: OnlineSettings = OnlineSettings()
    prior: Path | None = None
    workers: WorkerSettings = WorkerSettings()

    def check_together(self) -> None:
        if self.prior is not None and not self.online.learn_online:
            raise InputError(
                "--prior: expected it together with --learn-online; a run that is not "
                "to learn on the way is given as RUN"
            )
        if self.run is None and not self.online.learn_online:
            raise InputError(
                "RUN: expected the folder of a fit, or --learn-online with --task or "
                "--system"
            )
        if self.run is not None and self.online.learn_online:
            raise InputError(
                "--learn-online: expected no RUN, because the force is learned on the "
                "way; a fit to begin with is given as --prior RUN"
            )
        if self.online.task is None:
            self.settings.places()
        elif self.settings.start or self.settings.goal:
            raise InputError(
                "--task: expected no --from or --to, for the task has its own places; "
                "leave them out"
            )
