"""The start of a run: a new folder, or one that is continued."""

import hashlib
from typing import Any

import msgspec
import numpy as np

from pinav.commands.command import Command
from pinav.commands.settings import ResumableOptions, RunOptions
from pinav.errors import InputError
from pinav.runs import RunFolder
from pinav.trajectories import Trajectories


def start_run(
    command: Command, options: RunOptions, *settings: msgspec.Struct, **identity: str
) -> RunFolder:
    """Create or resume the folder of a run.

    Args:
        command: what makes the run.
        options: of the command line.
        settings: what decides the numbers of the run.
        identity: what else tells this run from others, such as a hash of its data.

    Raises:
        InputError: the folder cannot be used, or holds a run with other settings.
    """
    resume = isinstance(options, ResumableOptions) and options.resume
    if resume and options.overwrite:
        raise InputError("--resume and --overwrite: choose one of them")
    content = [
        item for s in settings for item in msgspec.to_builtins(s, enc_hook=str).items()
    ]
    config: dict[str, Any] = {
        key: list(value) if isinstance(value, tuple) else value
        for key, value in content
        if value is not None
    }
    config["run"] = {"command": command.name, **identity}
    if resume:
        return RunFolder.resume(options.out, config)
    return RunFolder.create(
        options.out,
        config,
        overwrite=options.overwrite,
        resumable=command.resumable,
    )


def fingerprint(data: Trajectories) -> str:
    """A short hash of the numbers that are fitted."""
    digest = hashlib.sha256()
    for array in (data.times, data.states, data.observed):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:16]
