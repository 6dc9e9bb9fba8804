"""A bead in a linear trap: its exact state space, likelihood and fit."""

from pinav.fitting.traps.fit import TrapFit as TrapFit
from pinav.fitting.traps.fit import fit_trap as fit_trap
from pinav.fitting.traps.likelihood import TrapData as TrapData
from pinav.fitting.traps.likelihood import TrapLikelihood as TrapLikelihood
from pinav.fitting.traps.likelihood import trap_likelihood as trap_likelihood
from pinav.fitting.traps.model import Propagator as Propagator
from pinav.fitting.traps.model import TrapModel as TrapModel
from pinav.fitting.traps.model import blur_factor as blur_factor
from pinav.fitting.traps.model import propagate as propagate
