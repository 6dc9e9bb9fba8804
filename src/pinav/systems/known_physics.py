"""The known physics in a file: forces, drag or mobility, noise."""

from typing import Any

import jax
import jax.numpy as jnp

from pinav.dynamics import OverdampedSwimmer, Swimmer, thermal_energy
from pinav.errors import InputError
from pinav.forces import (
    AbstractCommandedForce,
    AbstractFlow,
    AbstractForce,
    AbstractTensorField,
    InFlow,
    IsotropicTensor,
    LinearDrag,
    SumForce,
    ZeroFlow,
    ZeroForce,
    stokes_drag,
)
from pinav.settings import NOT_NEGATIVE, POSITIVE
from pinav.systems.codec import (
    TOML,
    Context,
    check_keys,
    decode_module,
    number,
)
from pinav.systems.system import Units


def section_of(table: TOML, key: str, known: tuple[str, ...]) -> TOML:
    """The table of a key, which states some of the known ones."""
    section = table.get(key, {})
    if not isinstance(section, dict):
        raise InputError(f"{key}: expected a table [{key}], got {section!r}")
    check_keys(key, section, dict.fromkeys(known))
    return section


def force_of(key: str, value: Any, context: Context) -> AbstractForce:
    """One force, or the sum of several; checked in the space of the system."""
    if isinstance(value, list):
        if not value:
            raise InputError(f"{key}: expected one or more tables [[{key}]], got none")
        terms = [force_of(f"{key}[{i}]", part, context) for i, part in enumerate(value)]
        return SumForce(tuple(terms)) if len(terms) > 1 else terms[0]
    force = decode_module(key, AbstractForce, value, context)
    if not (isinstance(force, AbstractCommandedForce) and force.unbound):
        _check_space(key, lambda x: force(0.0, x, x), context.dim)
    return force


def _check_space(key: str, function: Any, dim: int) -> None:
    point = jax.ShapeDtypeStruct((dim,), jnp.result_type(float))
    try:
        shape = jax.eval_shape(function, point).shape
    except (TypeError, ValueError, IndexError) as error:
        shape = f"an error ({' '.join(str(error).split())[:80]})"
    if shape != (dim,):
        raise InputError(
            f"{key}: expected {dim} components, as dimension = {dim} says, got "
            f"{shape}; choose a kind for that dimension"
        )


def swimmer_of(
    table: TOML, order: int, units: Units, context: Context
) -> tuple[Swimmer | OverdampedSwimmer, float | None]:
    """The known physics, and its thermal energy."""
    absent, needed = ("mobility", "drag") if order == 2 else ("drag", "mobility")
    if absent in table:
        raise InputError(
            f"{absent}: a system of order {order} has {needed} in its place; rename it"
        )
    thermal = section_of(
        table, "thermal", ("energy", "diffusion", "temperature", "radius", "viscosity")
    )
    thermal = {key: number(f"thermal.{key}", part) for key, part in thermal.items()}
    sphere = "radius" in thermal or "viscosity" in thermal
    if needed not in table and not sphere:
        raise InputError(
            f"{needed}: this key is missing; state the {needed} of the swimmer, a "
            "number or a table"
        )
    propulsion, known = (
        force_of(key, table[key], context) if key in table else ZeroForce()
        for key in ("propulsion", "forces")
    )
    flow = ZeroFlow()
    if "flow" in table:
        flow = decode_module("flow", AbstractFlow, table["flow"], context)
        _check_space("flow", lambda x: flow(0.0, x), context.dim)
    if order == 2:
        if thermal:
            raise InputError(
                "thermal: thermal noise needs order = 1, a swimmer without inertia; "
                "drop the table"
            )
        if isinstance(table["drag"], dict):
            drag = force_of("drag", table["drag"], context)
        else:
            NOT_NEGATIVE.check("drag", damping := number("drag", table["drag"]))
            drag = LinearDrag(damping)
        drag = drag if isinstance(flow, ZeroFlow) else InFlow(drag, flow)
        return Swimmer(propulsion, drag, ZeroForce(), known), None
    mobility = _mobility(table, thermal, units, context)
    swimmer = OverdampedSwimmer(propulsion, ZeroForce(), mobility, flow, known)
    return swimmer, _thermal_energy(thermal, mobility, units)


def _mobility(
    table: TOML, thermal: TOML, units: Units, context: Context
) -> AbstractTensorField:
    if "radius" in thermal or "viscosity" in thermal:
        if "mobility" in table:
            raise InputError(
                "mobility: thermal.radius and thermal.viscosity give it; drop one"
            )
        return IsotropicTensor(1 / _stokes_drag(thermal, units))
    value = table["mobility"]
    if not isinstance(value, dict):
        POSITIVE.check("mobility", mobility := number("mobility", value))
        return IsotropicTensor(mobility)
    tensor = decode_module("mobility", AbstractTensorField, value, context)
    _check_space("mobility", lambda x: tensor(x, x), context.dim)
    return tensor


def _stokes_drag(thermal: TOML, units: Units) -> float:
    _check_si("thermal.radius and thermal.viscosity", units)
    for key in ("radius", "viscosity"):
        if thermal.get(key, 0.0) <= 0:
            raise InputError(
                f"thermal.{key}: expected > 0 ({'um' if key == 'radius' else 'mPa s'}) "
                f"beside the other of radius and viscosity, got {thermal.get(key)}"
            )
    return stokes_drag(thermal["radius"], thermal["viscosity"])


def _check_si(key: str, units: Units) -> None:
    if (units.length, units.time, units.force) != ("um", "s", "pN"):
        raise InputError(
            f"{key}: expected the units um, s and pN, got {units.length}, {units.time} "
            f"and {units.force}; state them in [units], or thermal.diffusion instead"
        )


def _thermal_energy(
    thermal: TOML, mobility: AbstractTensorField, units: Units
) -> float | None:
    stated = [k for k in ("energy", "diffusion", "temperature") if k in thermal]
    if len(stated) > 1:
        raise InputError(f"thermal.{stated[1]}: {stated[0]} says it already; drop one")
    for key in stated:
        NOT_NEGATIVE.check(f"thermal.{key}", thermal[key])
    if "temperature" in thermal:
        _check_si("thermal.temperature", units)
        return thermal_energy(thermal["temperature"])
    if "diffusion" in thermal:
        if not isinstance(mobility, IsotropicTensor):
            raise InputError(
                "thermal.diffusion: expected a mobility that is a number; state "
                "thermal.energy, which times the mobility is the diffusion tensor"
            )
        return float(thermal["diffusion"] / mobility.value)
    return thermal.get("energy")
