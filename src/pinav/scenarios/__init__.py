"""Named true systems with their starts, times and noise."""

from pinav.scenarios.brownian import brownian
from pinav.scenarios.catalogue import SCENARIOS, scenario
from pinav.scenarios.crossings import barrier_crossings, moving_barrier, paper, swirl
from pinav.scenarios.currents import (
    channel_current,
    drift_current,
    shear_current,
    vortex_current,
)
from pinav.scenarios.find import find_system, source_system
from pinav.scenarios.media import (
    anisotropic_drag,
    poiseuille,
    porous,
    shear,
    varying_director,
)
from pinav.scenarios.paths import true_paths
from pinav.scenarios.random_fields import fibres, many_barriers

__all__ = [
    "SCENARIOS",
    "anisotropic_drag",
    "barrier_crossings",
    "brownian",
    "channel_current",
    "drift_current",
    "fibres",
    "find_system",
    "many_barriers",
    "moving_barrier",
    "paper",
    "poiseuille",
    "porous",
    "scenario",
    "shear",
    "shear_current",
    "source_system",
    "swirl",
    "true_paths",
    "varying_director",
    "vortex_current",
]
