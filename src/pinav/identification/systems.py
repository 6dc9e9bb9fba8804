"""A fitted response as a system, and the commands of a system."""

import dataclasses

import jax
import numpy as np

from pinav.dynamics import takes_commands
from pinav.errors import InputError
from pinav.fitting import EvidenceFit
from pinav.identification.parameters import (
    DRIFT,
    DRIVE,
    GAIN,
    Parameter,
    Scale,
)
from pinav.systems import (
    Flat,
    FreeNumber,
    LogNormal,
    Normal,
    Observation,
    System,
    Units,
    WanderingVelocity,
)
from pinav.trajectories import COMMAND_UNITS, Trajectories, commands_of


def system_of(
    fit: EvidenceFit, *, jitter: float, name: str, units: dict[str, str]
) -> System:
    """The system that a fitted candidate describes.

    Its environment is unknown. What was learned may be learned again: gain and drift
    with flat priors, delay, corner and residual gain with what the fit says of them.

    Args:
        fit: fit of a candidate to a track.
        jitter: standard deviation of single frames about the mean path [L].
        name: name of the system.
        units: units of the recording.
    """
    noise = {
        field.name: fit.constants[f"wandering.{field.name}"].value
        for field in dataclasses.fields(WanderingVelocity)
        if f"wandering.{field.name}" in fit.constants
    }
    return System(
        name=name,
        swimmer=jax.tree.map(lambda x: x if np.ndim(x) else float(x), fit.model),
        dim=2,
        wandering=WanderingVelocity(**noise),
        observation=Observation(noise=jitter),
        base_units=Units(length=units.get("x", "?"), time=units.get("t", "?")),
        model="kernel-potential",
        learn=_free_numbers(fit),
    )


def _free_numbers(fit: EvidenceFit) -> tuple[FreeNumber, ...]:
    drive = (
        FreeNumber(parameter.path, _prior(fit, parameter))
        for parameter in DRIVE
        if parameter.path in fit.constants
    )
    gain = (FreeNumber(GAIN, Flat()),) if f"{GAIN}[0, 0]" in fit.constants else ()
    drift = (FreeNumber(DRIFT, Flat()),) if f"{DRIFT}[0]" in fit.constants else ()
    return (*gain, *drive, *drift)


def _prior(fit: EvidenceFit, parameter: Parameter) -> Normal | LogNormal:
    """Prior of a number of the drive, about its estimate."""
    value, sd = (getattr(fit.constants[parameter.path], n) for n in ("value", "sd"))
    if parameter.scale is Scale.LOG:
        return LogNormal(median=value, deviation=max(sd / value, 1e-6))
    return Normal(mean=value, deviation=max(sd, 1e-6))


def needs_kalman_filter(system: System) -> bool:
    """True where a fit must be `fit_commanded`: commands or a wandering velocity."""
    return takes_commands(system.swimmer) or system.wandering is not None


def record_commands(system: System, data: Trajectories) -> Trajectories:
    """The data with the commands of the system's programme, where it has one.

    Those at the time of a sample are taken, to hold until the next one.

    Raises:
        InputError: the data record other commands.
    """
    stated = commands_of(system, data.times)
    for name, values in stated.items():
        recorded = data.commands.get(name)
        if recorded is not None and not np.allclose(recorded, values, equal_nan=True):
            raise InputError(
                f"system.propulsion.programme: the data record another {name} than "
                "the programme commands; leave the programme out, and the commands "
                "are those of the data"
            )
    units = {**data.units, **{name: COMMAND_UNITS[name] for name in stated}}
    return dataclasses.replace(data, commands={**data.commands, **stated}, units=units)
