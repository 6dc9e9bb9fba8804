"""Systems: swimmers with what is known and what is not, and their files."""

from pinav.systems.files import parse_system as parse_system
from pinav.systems.files import read_system as read_system
from pinav.systems.files import system_text as system_text
from pinav.systems.files import write_system as write_system
from pinav.systems.priors import AbstractNumberPrior as AbstractNumberPrior
from pinav.systems.priors import Flat as Flat
from pinav.systems.priors import FreeNumber as FreeNumber
from pinav.systems.priors import LogNormal as LogNormal
from pinav.systems.priors import Normal as Normal
from pinav.systems.starts import AbstractStarts as AbstractStarts
from pinav.systems.starts import CoastingStarts as CoastingStarts
from pinav.systems.starts import RingStarts as RingStarts
from pinav.systems.starts import UniformStarts as UniformStarts
from pinav.systems.system import Observation as Observation
from pinav.systems.system import System as System
from pinav.systems.system import Units as Units
from pinav.systems.system import WanderingVelocity as WanderingVelocity
from pinav.systems.system import velocity_unit as velocity_unit
