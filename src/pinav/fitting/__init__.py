"""Fitting: phases that minimise an objective, and the Bayesian fit of kernels."""

from pinav.fitting.bayes import BayesFit as BayesFit
from pinav.fitting.bayes import fit_bayes as fit_bayes
from pinav.fitting.conformal import Calibration as Calibration
from pinav.fitting.conformal import CalibrationOutcome as CalibrationOutcome
from pinav.fitting.conformal import calibrate as calibrate
from pinav.fitting.conformal import least_count as least_count
from pinav.fitting.conformal import rollout_bands as rollout_bands
from pinav.fitting.conformal import trajectory_scores as trajectory_scores
from pinav.fitting.derived import derived as derived
from pinav.fitting.derived import principal_drags as principal_drags
from pinav.fitting.derived import rotational_fraction as rotational_fraction
from pinav.fitting.evidence import Hyperparameters as Hyperparameters
from pinav.fitting.fit import Problem as Problem
from pinav.fitting.fit import fit as fit
from pinav.fitting.fit import fit_many as fit_many
from pinav.fitting.gauss_newton import GaussNewton as GaussNewton
from pinav.fitting.iteration import BayesOutcome as BayesOutcome
from pinav.fitting.iteration import BayesProgress as BayesProgress
from pinav.fitting.kernels import WITHOUT_PRIOR as WITHOUT_PRIOR
from pinav.fitting.kernels import KernelGrid as KernelGrid
from pinav.fitting.kernels import changing_environment as changing_environment
from pinav.fitting.kernels import kernel_environment as kernel_environment
from pinav.fitting.kernels import kernels_on as kernels_on
from pinav.fitting.kernels import (
    timed_kernel_environment as timed_kernel_environment,
)
from pinav.fitting.langevin import LangevinFit as LangevinFit
from pinav.fitting.langevin import fit_langevin as fit_langevin
from pinav.fitting.lifting import FreeModel as FreeModel
from pinav.fitting.lifting import freed as freed
from pinav.fitting.networks import neural_environment as neural_environment
from pinav.fitting.objectives import AbstractObjective as AbstractObjective
from pinav.fitting.objectives import Observations as Observations
from pinav.fitting.objectives import TrajectoryLoss as TrajectoryLoss
from pinav.fitting.occam import LinearFit as LinearFit
from pinav.fitting.occam import ModelEvidence as ModelEvidence
from pinav.fitting.occam import model_evidence as model_evidence
from pinav.fitting.phases import LBFGS as LBFGS
from pinav.fitting.phases import AbstractPhase as AbstractPhase
from pinav.fitting.phases import Adam as Adam
from pinav.fitting.phases import BestSoFar as BestSoFar
from pinav.fitting.posterior import Band as Band
from pinav.fitting.posterior import Estimate as Estimate
from pinav.fitting.posterior import Posterior as Posterior
from pinav.fitting.recipes import curriculum as curriculum
from pinav.fitting.recipes import paper_recipe as paper_recipe
from pinav.fitting.records import AbstractCheckpoint as AbstractCheckpoint
from pinav.fitting.records import Fit as Fit
from pinav.fitting.records import FitOutcome as FitOutcome
from pinav.fitting.records import FitProgress as FitProgress
from pinav.fitting.records import FitState as FitState
from pinav.fitting.refinement import Refinement as Refinement
