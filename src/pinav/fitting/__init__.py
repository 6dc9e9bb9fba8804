"""Fitting: phases that minimise an objective, and the Bayesian fit of kernels."""

from pinav.fitting.abstract_learned import AbstractLearned as AbstractLearned
from pinav.fitting.bayes.fit_bayes import fit_bayes as fit_bayes
from pinav.fitting.bayes.parameters import derive as derive
from pinav.fitting.bayes.parameters import principal_drags as principal_drags
from pinav.fitting.bayes.parameters import rotational_fraction as rotational_fraction
from pinav.fitting.engine.evidence_fit import EvidenceFit as EvidenceFit
from pinav.fitting.engine.evidence_fit import EvidenceProgress as EvidenceProgress
from pinav.fitting.engine.evidence_fit import GoodnessOfFit as GoodnessOfFit
from pinav.fitting.engine.local_model import ParametricModel as ParametricModel
from pinav.fitting.engine.local_model import ravel_model as ravel_model
from pinav.fitting.engine.posterior import Estimate as Estimate
from pinav.fitting.engine.posterior import Posterior as Posterior
from pinav.fitting.environments.catalogue import (
    neural_environment as neural_environment,
)
from pinav.fitting.environments.diagnosis import Cause as Cause
from pinav.fitting.environments.diagnosis import diagnose as diagnose
from pinav.fitting.environments.gradient_matching import prior_root as prior_root
from pinav.fitting.environments.gradient_matching import (
    rates_to_match as rates_to_match,
)
from pinav.fitting.environments.gradient_matching import (
    simpler_models as simpler_models,
)
from pinav.fitting.environments.kernels import KernelGrid as KernelGrid
from pinav.fitting.environments.kernels import (
    changing_environment as changing_environment,
)
from pinav.fitting.environments.kernels import kernel_environment as kernel_environment
from pinav.fitting.environments.kernels import (
    profile_environment as profile_environment,
)
from pinav.fitting.environments.kernels import (
    timed_kernel_environment as timed_kernel_environment,
)
from pinav.fitting.environments.kernels import warp_at_slow_end as warp_at_slow_end
from pinav.fitting.environments.rates import substeps_for as substeps_for
from pinav.fitting.environments.refinement import Refinement as Refinement
from pinav.fitting.evidence.evidence import Hyperparameters as Hyperparameters
from pinav.fitting.evidence.model_evidence import LinearFit as LinearFit
from pinav.fitting.evidence.model_evidence import ModelEvidence as ModelEvidence
from pinav.fitting.evidence.model_evidence import model_evidence as model_evidence
from pinav.fitting.langevin import ConstantDiffusion as ConstantDiffusion
from pinav.fitting.langevin import DiffusionField as DiffusionField
from pinav.fitting.langevin import KernelDiffusion as KernelDiffusion
from pinav.fitting.langevin import LangevinChecks as LangevinChecks
from pinav.fitting.langevin import LearnedObservation as LearnedObservation
from pinav.fitting.langevin import ObservedAxes as ObservedAxes
from pinav.fitting.langevin import ReferencePath as ReferencePath
from pinav.fitting.langevin import SlowReference as SlowReference
from pinav.fitting.langevin import ThermalResult as ThermalResult
from pinav.fitting.langevin import fit_langevin as fit_langevin
from pinav.fitting.langevin import judge_increments as judge_increments
from pinav.fitting.langevin import slow_reference as slow_reference
from pinav.fitting.matching.fit import Problem as Problem
from pinav.fitting.matching.fit import fit as fit
from pinav.fitting.matching.fit import fit_many as fit_many
from pinav.fitting.matching.gauss_newton import DefectMatching as DefectMatching
from pinav.fitting.matching.gauss_newton import GaussNewton as GaussNewton
from pinav.fitting.matching.gauss_newton import RateMatching as RateMatching
from pinav.fitting.matching.gauss_newton import Rates as Rates
from pinav.fitting.matching.phases import LBFGS as LBFGS
from pinav.fitting.matching.phases import AbstractPhase as AbstractPhase
from pinav.fitting.matching.phases import Adam as Adam
from pinav.fitting.matching.recipes import curriculum as curriculum
from pinav.fitting.matching.recipes import defect_recipe as defect_recipe
from pinav.fitting.matching.recipes import fit_in_turns as fit_in_turns
from pinav.fitting.matching.recipes import fit_with_finer_steps as fit_with_finer_steps
from pinav.fitting.matching.recipes import is_complete as is_complete
from pinav.fitting.matching.recipes import paper_recipe as paper_recipe
from pinav.fitting.matching.state import AbstractCheckpoint as AbstractCheckpoint
from pinav.fitting.matching.state import AbstractObjective as AbstractObjective
from pinav.fitting.matching.state import Fit as Fit
from pinav.fitting.matching.state import FitProgress as FitProgress
from pinav.fitting.matching.state import FitState as FitState
from pinav.fitting.matching.state import Observations as Observations
from pinav.fitting.matching.state import TrajectoryLoss as TrajectoryLoss
from pinav.fitting.outcome import Outcome as Outcome
from pinav.fitting.outcome import confirm as confirm
from pinav.fitting.structure.fits import StructuredFit as StructuredFit
from pinav.fitting.structure.survey import is_network as is_network
from pinav.fitting.structure.survey import is_worth_a_search as is_worth_a_search
from pinav.fitting.structure.survey import may_turn as may_turn
from pinav.fitting.structured import fit_structured as fit_structured
