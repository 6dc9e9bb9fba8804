"""Systems by their names: built-in scenarios, files, names in a Python file."""

from collections.abc import Mapping
from typing import Any

from jaxtyping import PRNGKeyArray

from pinav.errors import InputError
from pinav.scenarios.crossings import (
    barrier_crossings,
    fibres,
    many_barriers,
    moving_barrier,
    paper,
    swirl,
)
from pinav.scenarios.media import (
    anisotropic_drag,
    channel_current,
    drift_current,
    poiseuille,
    porous,
    shear,
    shear_current,
    varying_director,
    vortex_current,
)
from pinav.scenarios.starts_and_thrusts import Scenario
from pinav.scenarios.thermal_truths import brownian, ring, wall
from pinav.scenarios.vessels import above_wall, bifurcation, box, tube
from pinav.systems import System, parse_system, read_system

SCENARIOS: dict[str, Scenario] = {
    "paper": paper,
    "barrier-crossings": barrier_crossings,
    "many-barriers": many_barriers,
    "fibres": fibres,
    "swirl": swirl,
    "anisotropic-drag": anisotropic_drag,
    "varying-director": varying_director,
    "moving-barrier": moving_barrier,
    "porous": porous,
    "shear": shear,
    "poiseuille": poiseuille,
    "brownian": brownian,
    "shear-current": shear_current,
    "channel-current": channel_current,
    "vortex-current": vortex_current,
    "drift-current": drift_current,
    "box": box,
    "above-wall": above_wall,
    "tube": tube,
    "bifurcation": bifurcation,
    "wall": wall,
    "ring": ring,
}
"""Named scenarios: each takes an optional random key and number of trajectories."""


def scenario(
    name: str, key: PRNGKeyArray | None = None, *, count: int | None = None
) -> System:
    """The system of that name, with its true environment.

    Args:
        key: random key of random starts.
        count: number of trajectories with random starts, the scenario's own by default;
            larger numbers begin with the same ones.

    Raises:
        InputError: no scenario has that name, or `count` is not positive.
    """
    if name not in SCENARIOS:
        known = ", ".join(sorted(SCENARIOS))
        raise InputError(f"scenario {name!r} is unknown; choose one of: {known}")
    return SCENARIOS[name](key, count)


def find_system(
    text: str, key: PRNGKeyArray | None = None, *, count: int | None = None
) -> System:
    """The system of a scenario, of `my.toml`, or of `my.py:name`, which is run.

    Raises:
        InputError: there is no such system, or its file is at fault.
    """
    if text in SCENARIOS:
        return scenario(text, key, count=count)
    if not (text.endswith(".toml") or ".py:" in text):
        raise InputError(
            f"system {text!r} is unknown; name a file such as my.toml, my.py:name, or "
            f"one of the scenarios: {', '.join(sorted(SCENARIOS))}"
        )
    system = read_system(text)
    if count is None and not (key is not None and system.starts_follow_rule):
        return system
    return system.with_starts(key, count)


def source_system(provenance: Mapping[str, Any]) -> System | None:
    """The system that data were simulated from; None where they do not say so.

    Raises:
        InputError: the text of the system is damaged, or it names Python code.
    """
    if text := provenance.get("system"):
        return parse_system(str(text))
    name = provenance.get("scenario")
    return SCENARIOS[name]() if name in SCENARIOS else None
