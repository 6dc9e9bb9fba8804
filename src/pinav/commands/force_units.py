"""The units in which the reports and tables of a run show its forces."""

from collections.abc import Mapping

from pinav.systems import System
from pinav.trajectories import Trajectories
from pinav.units import with_order


def units_of(data: Trajectories, system: System) -> Mapping[str, str]:
    """Units of the channels, with the order of the dynamics and the unit of a force."""
    return with_order(data.units, system.order, system.base_units.force)
