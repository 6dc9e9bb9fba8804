"""A bead in a linear trap: its exact state space, likelihood and fit."""

from validation.truth.trap_fit.fit import TrapFit as TrapFit
from validation.truth.trap_fit.fit import fit_trap as fit_trap
from validation.truth.trap_fit.likelihood import TrapData as TrapData
from validation.truth.trap_fit.likelihood import TrapLikelihood as TrapLikelihood
from validation.truth.trap_fit.likelihood import trap_likelihood as trap_likelihood
from validation.truth.trap_fit.model import Propagator as Propagator
from validation.truth.trap_fit.model import TrapModel as TrapModel
from validation.truth.trap_fit.model import blur_factor as blur_factor
from validation.truth.trap_fit.model import propagate as propagate
