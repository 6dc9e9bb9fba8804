"""Named true systems with their starts, times and noise."""

from pinav.scenarios.catalogue import SCENARIOS as SCENARIOS
from pinav.scenarios.catalogue import find_system as find_system
from pinav.scenarios.catalogue import scenario as scenario
from pinav.scenarios.catalogue import source_system as source_system
from pinav.scenarios.crossings import barrier_crossings as barrier_crossings
from pinav.scenarios.crossings import fibres as fibres
from pinav.scenarios.crossings import many_barriers as many_barriers
from pinav.scenarios.crossings import moving_barrier as moving_barrier
from pinav.scenarios.crossings import paper as paper
from pinav.scenarios.crossings import swirl as swirl
from pinav.scenarios.media import anisotropic_drag as anisotropic_drag
from pinav.scenarios.media import channel_current as channel_current
from pinav.scenarios.media import drift_current as drift_current
from pinav.scenarios.media import poiseuille as poiseuille
from pinav.scenarios.media import porous as porous
from pinav.scenarios.media import shear as shear
from pinav.scenarios.media import shear_current as shear_current
from pinav.scenarios.media import varying_director as varying_director
from pinav.scenarios.media import vortex_current as vortex_current
from pinav.scenarios.thermal_truths import brownian as brownian
from pinav.scenarios.thermal_truths import ring as ring
from pinav.scenarios.thermal_truths import wall as wall
from pinav.scenarios.vessels import above_wall as above_wall
from pinav.scenarios.vessels import bifurcation as bifurcation
from pinav.scenarios.vessels import box as box
from pinav.scenarios.vessels import tube as tube
