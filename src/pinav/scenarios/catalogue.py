"""Built-in systems by their names."""

from jaxtyping import PRNGKeyArray

from pinav.errors import InputError
from pinav.scenarios.brownian import brownian
from pinav.scenarios.crossings import barrier_crossings, moving_barrier, paper, swirl
from pinav.scenarios.currents import (
    channel_current,
    drift_current,
    shear_current,
    vortex_current,
)
from pinav.scenarios.media import (
    anisotropic_drag,
    poiseuille,
    porous,
    shear,
    varying_director,
)
from pinav.scenarios.random_fields import fibres, many_barriers
from pinav.scenarios.random_starts import Scenario
from pinav.scenarios.spaces import box
from pinav.scenarios.thermal_truths import ring, wall
from pinav.scenarios.vessels import above_wall, bifurcation, tube
from pinav.systems import System

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
        name: a key of `SCENARIOS`.
        key: random key of its starts, where they are random.
        count: number of trajectories, where the starts are random; more of a key
            begin with the same ones. The scenario's own number unless given.

    Raises:
        InputError: no scenario has that name, or `count` is not positive.
    """
    if name not in SCENARIOS:
        known = ", ".join(sorted(SCENARIOS))
        raise InputError(f"scenario {name!r} is unknown; choose one of: {known}")
    return SCENARIOS[name](key, count)
