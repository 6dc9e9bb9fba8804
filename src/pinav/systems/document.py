"""A system as the tables of a TOML file."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from pinav.dynamics import Swimmer
from pinav.forces import (
    AbstractForce,
    InFlow,
    SumForce,
    ZeroFlow,
    ZeroForce,
)
from pinav.systems.codec import (
    TOML,
    encode,
)
from pinav.systems.system import System


def document_of(system: System) -> TOML:
    """What a file states of a system."""
    swimmer = system.swimmer
    document: TOML = {"name": system.name, "dimension": system.dim}
    document |= {"order": system.order, "units": _fields("units", system.base_units)}
    if not isinstance(swimmer.propulsion, ZeroForce):
        document["propulsion"] = encode("propulsion", swimmer.propulsion)
    if isinstance(swimmer, Swimmer):
        drag, flow = swimmer.drag, ZeroFlow()
        if isinstance(drag, InFlow):
            drag, flow = drag.force, drag.flow
        document["drag"] = encode("drag", drag)
    else:
        flow = swimmer.flow
        document["mobility"] = encode("mobility", swimmer.mobility)
    if not isinstance(flow, ZeroFlow):
        document["flow"] = encode("flow", flow)
    if not isinstance(swimmer.known_force, ZeroForce):
        document["forces"] = _forces("forces", swimmer.known_force)
    if system.thermal_energy is not None:
        document["thermal"] = {"energy": float(system.thermal_energy)}
    document["observation"] = _fields("observation", system.observation)
    if system.wandering is not None:
        document["wandering"] = _fields("wandering", system.wandering)
    if system.learn:
        document["learn"] = {
            one.path: encode(f"learn.{one.path}", one.prior) for one in system.learn
        }
    document["unknown"] = {"model": system.model} | system.thermal.table()
    if system.environment is not None:
        document["truth"] = _forces("truth", system.environment)
    return document | _sampling(system)


def _sampling(system: System) -> TOML:
    tables: TOML = {}
    if system.rule is not None:
        tables["starts"] = encode("starts", system.rule)
    if len(system.starts) and not system.starts_follow_rule:
        states = encode("starts", system.starts)
        tables["starts"] = {**tables.get("starts", {}), "states": states}
    if len(system.times):
        times = np.asarray(system.times)
        first, last, samples = float(times[0]), float(times[-1]), len(times)
        if np.array_equal(jnp.linspace(first, last, samples), times):
            tables["times"] = {"first": first, "last": last, "samples": samples}
        else:
            tables["times"] = {"values": encode("times", system.times)}
    return tables


def _fields(key: str, value: eqx.Module) -> TOML:
    """A table without kind."""
    table = encode(key, value)
    return {name: part for name, part in table.items() if name != "kind"}


def _forces(key: str, force: AbstractForce) -> Any:
    if isinstance(force, SumForce):
        return [encode(key, term) for term in force.terms]
    return encode(key, force)
