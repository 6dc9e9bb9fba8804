"""Named true systems with their starts, times and noise."""

from pinav.scenarios.catalogue import SCENARIOS as SCENARIOS
from pinav.scenarios.catalogue import find_system as find_system
from pinav.scenarios.catalogue import scenario as scenario
from pinav.scenarios.catalogue import source_system as source_system
from pinav.scenarios.planar import barrier_crossings as barrier_crossings
from pinav.scenarios.planar import paper as paper
from pinav.scenarios.viscous import box as box
