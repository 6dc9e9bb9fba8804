"""Candidates: systems with open constants, among which the evidence chooses.

Numbers that a candidate leaves open have placeholders; those of its noise are learned
in every fit.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from pinav.dynamics import OverdampedSwimmer, takes_commands
from pinav.errors import InputError
from pinav.fitting import EvidenceFit
from pinav.forces import RollingPropulsion, UniformFlow, ZeroFlow, ZeroForce
from pinav.identification.drive import RESPONSES, drive_numbers, gain_of
from pinav.identification.parameters import DRIFT, GAIN, ROLLING
from pinav.systems import (
    Flat,
    FreeNumber,
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
    gain = (FreeNumber(GAIN, Flat()),) if f"{GAIN}[0, 0]" in fit.constants else ()
    drift = (FreeNumber(DRIFT, Flat()),) if f"{DRIFT}[0]" in fit.constants else ()
    return (*gain, *drive_numbers(fit), *drift)


def needs_kalman_filter(system: System) -> bool:
    """True where a fit must be `fit_commanded`: commands or a wandering velocity."""
    return takes_commands(system.swimmer) or system.wandering is not None


def record_commands(system: System, data: Trajectories) -> Trajectories:
    """The data with the commands of the system's programme, held from sample to sample.

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


CHANGING = WanderingVelocity(still=1.0, driven=1.0, memory=1.0, slow=1.0)
"""Placeholder of a wandering velocity with a drift that changes."""


def drift_only() -> System:
    """The candidate without propulsion: a constant drift."""
    return _candidate("drift only", None, drift=True)


def scalar_gain() -> System:
    """The candidate with one number for its gain, and no drift."""
    return _candidate("scalar gain", 1.0, drift=False)


def axis_gains() -> System:
    """The candidate with a gain for each axis, which turns no heading, and drift."""
    return _candidate("gains", np.ones(2), drift=True)


def gain_matrix() -> System:
    """The candidate with any gain matrix and a drift."""
    return _candidate("gain matrix and drift", np.eye(2), drift=True)


def _candidate(name: str, gain: ArrayLike | None, *, drift: bool) -> System:
    with jax.enable_x64(new_val=True):
        propulsion = ZeroForce() if gain is None else RollingPropulsion(gain=gain)
        flow = UniformFlow(jnp.zeros(2)) if drift else ZeroFlow()
        learn = (
            *(() if gain is None else (FreeNumber(GAIN),)),
            *((FreeNumber(DRIFT),) if drift else ()),
        )
        swimmer = OverdampedSwimmer(propulsion, ZeroForce(), 1.0, flow)
        return System(name=name, swimmer=swimmer, dim=2, learn=learn)


def with_response(system: System, response: str) -> System:
    """A candidate of linear response with another one, whose numbers are learned."""
    if response == "linear":
        return system
    made = RESPONSES[response]
    paths = [f"propulsion.response.{f.name}" for f in dataclasses.fields(made)]
    changed = eqx.tree_at(lambda s: s.swimmer.propulsion.response, system, made)
    return with_learned(changed, response, *paths)


CANDIDATES: tuple[Callable[[], System], ...] = tuple(
    lambda response=response: with_response(gain_matrix(), response)
    for response in RESPONSES
)
"""Propulsions that are compared where there are commands, each with a drift."""


def with_learned(system: System, label: str, *paths: str) -> System:
    """A candidate with further numbers learned, such as `propulsion.delay`."""
    learn = (*system.learn, *map(FreeNumber, paths))
    return dataclasses.replace(system, name=f"{system.name} + {label}", learn=learn)


def with_slow_drift(system: System) -> System:
    """A candidate whose drift changes slowly."""
    name = f"{system.name} + time-dependent drift"
    return dataclasses.replace(system, name=name, wandering=CHANGING)


def like(base: System, other: System) -> System:
    """A candidate with the gain and drift of `base`, and all else of `other`.

    Where either does not roll only the noise of the other is taken; with nothing to
    take the base itself is returned.
    """
    drive: tuple[FreeNumber, ...] = ()
    propulsion: Any = base.swimmer.propulsion
    if gain_of(base.swimmer) is not None and gain_of(other.swimmer) is not None:
        paths = {parameter.path for parameter in ROLLING}
        drive = tuple(number for number in other.learn if number.path in paths)
        gain = propulsion.gain
        propulsion = dataclasses.replace(other.swimmer.propulsion, gain=gain)
    if not drive and other.wandering is None:
        return base
    return dataclasses.replace(
        base,
        name=f"{base.name}, else as chosen",
        swimmer=dataclasses.replace(base.swimmer, propulsion=propulsion),
        wandering=other.wandering,
        learn=(*base.learn, *drive),
    )
