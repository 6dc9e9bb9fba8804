"""Systems as TOML files: strict, and exact there and back."""

import os
import re
import tomllib
import typing
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import tomli_w

from pinav.arguments import on_device
from pinav.dynamics import Swimmer
from pinav.errors import InputError
from pinav.files import check_regular, write_text
from pinav.forces import AbstractForce, InFlow, SumForce, ZeroFlow, ZeroForce
from pinav.settings import ThermalSettings, split_period
from pinav.systems.codec import (
    TOML,
    Context,
    check_keys,
    decode,
    decode_module,
    encode,
    load_name,
    number,
)
from pinav.systems.known_physics import force_of, section_of, swimmer_of
from pinav.systems.priors import AbstractNumberPrior, FreeNumber
from pinav.systems.starts import AbstractStarts
from pinav.systems.system import (
    MODELS,
    Observation,
    System,
    Units,
    WanderingVelocity,
)

MAX_BYTES = 2**22
"""Size of a file that is no statement of a system any more."""

KEYS = (
    *("name", "dimension", "order", "units", "propulsion", "drag", "mobility", "flow"),
    *("forces", "thermal", "observation", "wandering", "learn", "unknown", "truth"),
    *("starts", "times"),
)
"""Tables and keys that a file may have."""

THERMAL = ThermalSettings.__struct_fields__
"""Keys of [unknown] on thermal motion."""

DECAYS = "decays"
"""Key of [unknown] by which a system states that the force ends where the data do."""


def read_system(path: str | os.PathLike[str]) -> System:
    """Read a system from a TOML file, or from a Python file as `file.py:name`.

    A name in a Python file is a `System` or a function without arguments that returns
    one; reading it runs the file.

    Raises:
        InputError: the file cannot be read or states no system; the message names the
            file, the key and the remedy.
    """
    text = os.fspath(path)
    if ".py:" in text:
        return _python_system(text)
    path = Path(path)
    if path.suffix != ".toml":
        raise InputError(f"{text}: expected a name ending in .toml, or file.py:name")
    try:
        check_regular(path)
        with open(path, "rb") as file:
            content = file.read(MAX_BYTES + 1)
    except InputError as error:
        raise InputError(f"{text}: {error}") from error
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"{text}: cannot read: {reason}; check the name") from error
    if len(content) > MAX_BYTES:
        raise InputError(f"{text}: expected at most 4 MiB; name the file of a system")
    try:
        return parse_system(content.decode(), folder=path.parent, name=path.stem)
    except UnicodeDecodeError as error:
        raise InputError(f"{text}: expected UTF-8 text; save it as such") from error
    except InputError as error:
        raise InputError(f"{text}: {error}") from error


def write_system(
    system: System, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write a system to a TOML file, from which `read_system` gives it back exactly.

    Raises:
        InputError: the system holds what a file cannot state, such as a network, or
            the file cannot be written.
    """
    write_text(path, system_text(system), overwrite=overwrite)


def system_text(system: System) -> str:
    """A system as the text of a TOML file; errors as of `write_system`."""
    document = {key: part for key, part in _document(system).items() if part != {}}
    rows = re.compile(r"\[\s+(-?[\d.e+-]+,\s+)+\]")  # numbers of a vector in one line
    return rows.sub(_in_one_line, tomli_w.dumps(document))


def _in_one_line(match: re.Match[str]) -> str:
    numbers = match.group()[1:-1].replace(",", " ").split()
    return f"[{', '.join(numbers)}]"


def _python_system(reference: str) -> System:
    value = load_name("system", reference, Path())
    if callable(value) and not isinstance(value, System):
        try:
            value = value()
        except Exception as error:
            reason = " ".join(str(error).split())
            raise InputError(
                f"{reference}: {type(error).__name__}: {reason}; the function is "
                "called without arguments and returns a System"
            ) from error
    if not isinstance(value, System):
        raise InputError(
            f"{reference}: expected a System, or a function that returns one, got a "
            f"{type(value).__name__}"
        )
    return value


def parse_system(text: str, *, folder: Path | None = None, name: str = "") -> System:
    """The system that a TOML text states.

    Args:
        folder: base of relative names of Python files; none are run by default.
        name: name of the system, where the text states none.

    Raises:
        InputError: the text states no system.
    """
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"not TOML: {error}; correct that line") from error
    check_keys("", table, dict.fromkeys(KEYS), ("dimension", "order"))
    dim, order = (decode(k, int, table[k], Context(2, None)) for k in KEYS[1:3])
    for key, value, allowed in (
        ("dimension", dim, (1, 2, 3)),
        ("order", order, (1, 2)),
    ):
        if value not in allowed:
            known = " or ".join(map(str, allowed))
            raise InputError(f"{key}: expected {known}, got {value}")
    context = Context(dim, folder)
    units = _plain(Units, "units", table, context) or Units()
    swimmer, energy = swimmer_of(table, order, units, context)
    rule, starts = _starts(table, order, context)
    return System(
        name=decode("name", str, table.get("name", name), context),
        swimmer=swimmer,
        dim=dim,
        environment=force_of("truth", table["truth"], context)
        if "truth" in table
        else None,
        thermal_energy=energy,
        wandering=_plain(WanderingVelocity, "wandering", table, context),
        observation=_plain(Observation, "observation", table, context) or Observation(),
        starts=starts,
        rule=rule,
        times=_times(table),
        base_units=units,
        model=_model(table, context),
        decays=_decays(table, context),
        thermal=_thermal(table, order, context),
        learn=_learn(table, context),
    )


def _plain(cls: Any, key: str, table: TOML, context: Context) -> Any:
    return decode_module(key, cls, table[key], context) if key in table else None


def _model(table: TOML, context: Context) -> str:
    unknown = section_of(table, "unknown", ("model", DECAYS, *THERMAL))
    default = System.__dataclass_fields__["model"].default
    model = decode("unknown.model", str, unknown.get("model", default), context)
    if model not in MODELS:
        raise InputError(
            f"unknown.model: expected one of {', '.join(MODELS)}; got {model!r}"
        )
    return model


def _decays(table: TOML, context: Context) -> bool:
    stated = table.get("unknown", {}).get(DECAYS, False)
    return decode(f"unknown.{DECAYS}", bool, stated, context)


def _thermal(table: TOML, order: int, context: Context) -> ThermalSettings:
    """The settings of the table [unknown], in which `period` is a table of numbers."""
    unknown = table.get("unknown", {})
    stated = {key: unknown[key] for key in THERMAL if key in unknown}
    if stated and order == 2:
        raise InputError(
            f"unknown.{next(iter(stated))}: thermal motion needs order = 1, a swimmer "
            "without inertia; drop it"
        )
    periods = stated.pop("period", {})
    if not isinstance(periods, dict):
        raise InputError(
            "unknown.period: expected numbers by coordinate, such as "
            f"{{ x = 6.2832 }}, got {periods!r}"
        )
    numbers = {k: number(f"unknown.period.{k}", v) for k, v in periods.items()}
    words = [f"{name}={period!r}" for name, period in numbers.items()]
    kinds = typing.get_type_hints(ThermalSettings)
    settings = ThermalSettings(
        **{
            name: decode(f"unknown.{name}", kinds[name], value, context)
            for name, value in {**stated, "period": words}.items()
        }
    )
    settings.check()
    return settings


def _state_thermal(settings: ThermalSettings) -> TOML:
    """What the table [unknown] states beside the model."""
    table: TOML = {name: one for name in THERMAL if (one := getattr(settings, name))}
    if settings.period:
        table["period"] = dict(map(split_period, settings.period))
    return table


def _learn(table: TOML, context: Context) -> tuple[FreeNumber, ...]:
    learn = table.get("learn", {})
    if not isinstance(learn, dict):
        raise InputError(f"learn: expected a table [learn] of priors, got {learn!r}")
    return tuple(
        FreeNumber(
            path, decode_module(f"learn.{path!r}", AbstractNumberPrior, prior, context)
        )
        for path, prior in learn.items()
    )


def _starts(
    table: TOML, order: int, context: Context
) -> tuple[AbstractStarts | None, Any]:
    if "starts" not in table:
        return None, ()
    section = table["starts"]
    if not isinstance(section, dict) or not {"kind", "states"} & set(section):
        raise InputError(
            "starts: expected a table with states = [[...], ...], or with the kind of "
            "a rule"
        )
    states = section.get("states", [])
    if "states" in section:
        try:
            states = np.asarray(states, float)
        except (ValueError, TypeError) as error:
            raise InputError("starts.states: expected rows of equal length") from error
        if states.ndim != 2 or not np.isfinite(states).all():
            raise InputError(
                "starts.states: expected rows of finite numbers, one for each start"
            )
    stated = {key: value for key, value in section.items() if key != "states"}
    if not stated:
        return None, on_device(states)
    rule = decode_module("starts", AbstractStarts, stated, context)
    try:
        drawn = rule.draw(order)
    except InputError as error:
        raise InputError(f"starts: {error}") from error
    return rule, on_device(states) if "states" in section else drawn


def _times(table: TOML) -> Any:
    section = section_of(table, "times", ("values", "first", "last", "samples", "step"))
    if not section:
        return ()
    if "values" in section:
        check_keys("times", section, {"values": None})
        values = section["values"]
        if not isinstance(values, list):
            raise InputError(f"times.values: expected a list [...], got {values!r}")
        times = np.asarray([number("times.values", time) for time in values])
    else:
        times = _even_times(section)
    if len(times) < 2 or not (np.diff(times) > 0).all():
        raise InputError("times: expected two or more increasing times")
    return on_device(times)


def _even_times(section: TOML) -> np.ndarray:
    check_keys("times", section, section, ("last",))
    first, last = number("times.first", section.get("first", 0)), section["last"]
    last = number("times.last", last)
    if ("samples" in section) == ("step" in section):
        raise InputError("times: expected either samples or step beside first and last")
    if "samples" in section:
        samples = decode("times.samples", int, section["samples"], Context(2, None))
    else:
        step = number("times.step", section["step"])
        if step <= 0:
            raise InputError(f"times.step: expected > 0, got {step}")
        samples = round((last - first) / step) + 1
    if not 2 <= samples <= 10**7:
        raise InputError(f"times: expected 2 to 10000000 samples, got {samples}")
    return np.asarray(jnp.linspace(first, last, samples))


def _document(system: System) -> TOML:
    swimmer = system.swimmer
    document: TOML = {"name": system.name, "dimension": system.dim}
    document |= {
        "order": system.order,
        "units": _without_kind("units", system.base_units),
    }
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
        document["forces"] = _state_forces("forces", swimmer.known_force)
    if system.thermal_energy is not None:
        document["thermal"] = {"energy": float(system.thermal_energy)}
    document["observation"] = _without_kind("observation", system.observation)
    if system.wandering is not None:
        document["wandering"] = _without_kind("wandering", system.wandering)
    if system.learn:
        document["learn"] = {
            one.path: encode(f"learn.{one.path}", one.prior) for one in system.learn
        }
    decays: TOML = {DECAYS: True} if system.decays else {}
    unknown = {"model": system.model} | decays | _state_thermal(system.thermal)
    document["unknown"] = unknown
    if system.environment is not None:
        document["truth"] = _state_forces("truth", system.environment)
    return document | _state_sampling(system)


def _state_sampling(system: System) -> TOML:
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


def _without_kind(key: str, value: eqx.Module) -> TOML:
    table = encode(key, value)
    return {name: part for name, part in table.items() if name != "kind"}


def _state_forces(key: str, force: AbstractForce) -> Any:
    if isinstance(force, SumForce):
        return [encode(key, term) for term in force.terms]
    return encode(key, force)
