"""The system of a fit: chosen on the command line, kept in the run."""

from typing import Annotated

import tyro

from pinav.errors import InputError
from pinav.runs import RunFolder
from pinav.scenarios import scenario
from pinav.systems import System
from pinav.trajectories import Trajectories


def choose_system(text: str | None, data: Trajectories) -> System:
    """The system that the option names, or the one that the data come from.

    Args:
        text: of the option `--system`.
        data: trajectories, which may say what they were simulated from.

    Raises:
        InputError: no system is named and the data do not say where they come from.
    """
    name = text or data.provenance.get("scenario")
    if name is None:
        raise InputError(
            "--system: the data do not say which system they come from; give a "
            "system file, or the name of a built-in one such as --system paper"
        )
    return scenario(name)


def read_system_of(folder: RunFolder) -> System:
    """The system of a run."""
    return scenario(folder.identity()["system"])
