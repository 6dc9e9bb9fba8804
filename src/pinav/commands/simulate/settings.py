"""Settings of `pinav simulate`."""

from typing import Annotated

import msgspec
import tyro

from pinav.commands.settings import _check_counts
from pinav.errors import InputError


class SimulateSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of `pinav simulate`."""

    seed: Annotated[
        int, tyro.conf.arg(help="Seed of random starts and observation noise.")
    ] = 0
    noise: Annotated[
        float | None,
        tyro.conf.arg(help="Standard deviation of observation noise, in every state."),
    ] = None
    count: Annotated[
        int | None,
        tyro.conf.arg(
            help="Number of trajectories; that of the scenario unless given. More of a "
            "seed begin with the same ones."
        ),
    ] = None
    frame_loss: Annotated[
        float, tyro.conf.arg(help="Probability that a sample is missing.")
    ] = 0.0
    positions_only: Annotated[
        bool, tyro.conf.arg(help="Leave the velocities unobserved.")
    ] = False

    def check(self) -> None:
        """Raise `InputError` where a setting makes no sense."""
        if self.noise is not None and self.noise < 0:
            raise InputError(f"--noise: expected 0 or more, got {self.noise}")
        if not 0 <= self.frame_loss < 1:
            raise InputError(
                f"--frame-loss: expected from 0 to below 1, got {self.frame_loss}"
            )
        if self.count is not None:
            _check_counts(self, "count")
