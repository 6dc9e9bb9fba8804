"""Settings of `pinav navigate`; imports no numerical library."""

from pathlib import Path
from typing import Annotated

import tyro

from pinav.commands.settings import (
    ALONE,
    Range,
    ResumableOptions,
    Settings,
    WorkerSettings,
)
from pinav.commands.steering_settings import SteeringSettings
from pinav.errors import InputError


class NavigateSettings(SteeringSettings, frozen=True):
    """Where to go, with which swimmer, and how it is tried.

    Attributes:
        sensor_noise: Error of what the controller is told of the state.
        samples: Models drawn from the posterior, whose spread makes uncertain regions
            cost more; 0 or 1, which has none, takes the model for true.
        seeds: Runs of each controller, each with its own noise.
    """

    sensor_noise: Annotated[float, Range(0)] = 0.0
    samples: Annotated[int, Range(0)] = 8
    seeds: Annotated[int, Range(1)] = 20


class OnlineSettings(Settings, frozen=True):
    """Learning of a force on the way.

    Attributes:
        learn_online: Learn the force while steering: name of a task, such as
            barrier-weak, with places of its own; or, with --from and --to, a system
            (a file, or the name of a built-in one) whose true environment the swimmer
            does not know.
        position_noise: Standard deviation of the observed positions.
        visits: How often each swimmer does the task, with the map kept.
    """

    learn_online: str | None = None
    position_noise: Annotated[float, Range(above=0)] = 0.02
    visits: Annotated[int, Range(1)] = 2


class NavigateOptions(ResumableOptions, frozen=True, kw_only=True):
    """Go from a place to a place through the force that a run has learned.

    Plans on the learned force (from where the goal cannot be reached, and where the
    model is uncertain), steers by model-predictive control, and tries it in closed
    loop: in the true environment where the data are those of a scenario, else in
    environments drawn from the posterior. Physics alone and, where it is known, the
    same controller with the truth are tried beside it. The run also suggests the
    trajectory that would tell most about the force along the route. Writes
    metrics.json, report.html, figures and an animation. A negative number takes an
    equals sign: --from=-1,2. With --learn-online the force of a named task, or of a
    system, is learned on the way, from noisy positions alone; RUN, where it is given,
    is a fit with a posterior, whose force is the first guess.

    Attributes:
        run: Folder of pinav fit, of trajectories or of a recording; with --learn-online
            of a fit to begin with, or none.
        workers: Who does the closed loops of all seeds.
        anyway: Steer by a force by which the verdict of its fit forbids to steer.
    """

    run: tyro.conf.Positional[Path | None] = None
    settings: NavigateSettings = NavigateSettings()
    online: OnlineSettings = OnlineSettings()
    workers: WorkerSettings = ALONE
    anyway: bool = False

    def check_together(self) -> None:
        if self.run is None and self.online.learn_online is None:
            raise InputError(
                "RUN: expected the folder of a fit, or --learn-online with the name of "
                "a task or a system, such as --learn-online barrier-weak"
            )
