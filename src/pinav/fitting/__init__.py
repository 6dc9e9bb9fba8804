"""Fitting: phases that minimise an objective, and the Bayesian fit of kernels."""

from pinav.fitting.bayes import BayesFit as BayesFit
from pinav.fitting.bayes import BayesOutcome as BayesOutcome
from pinav.fitting.bayes import Estimate as Estimate
from pinav.fitting.bayes import fit_bayes as fit_bayes
from pinav.fitting.evidence import Hyperparameters as Hyperparameters
from pinav.fitting.fit import AbstractCheckpoint as AbstractCheckpoint
from pinav.fitting.fit import Fit as Fit
from pinav.fitting.fit import FitOutcome as FitOutcome
from pinav.fitting.fit import FitProgress as FitProgress
from pinav.fitting.fit import FitState as FitState
from pinav.fitting.fit import Problem as Problem
from pinav.fitting.fit import fit as fit
from pinav.fitting.fit import fit_many as fit_many
from pinav.fitting.gauss_newton import GaussNewton as GaussNewton
from pinav.fitting.kernels import kernel_environment as kernel_environment
from pinav.fitting.objectives import AbstractObjective as AbstractObjective
from pinav.fitting.objectives import Observations as Observations
from pinav.fitting.objectives import TrajectoryLoss as TrajectoryLoss
from pinav.fitting.phases import LBFGS as LBFGS
from pinav.fitting.phases import AbstractPhase as AbstractPhase
from pinav.fitting.phases import Adam as Adam
from pinav.fitting.phases import BestSoFar as BestSoFar
from pinav.fitting.posterior import Band as Band
from pinav.fitting.posterior import Posterior as Posterior
from pinav.fitting.recipes import curriculum as curriculum
from pinav.fitting.recipes import paper_recipe as paper_recipe
