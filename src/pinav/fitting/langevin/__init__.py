"""Thermal motion without inertia: forces, diffusion and observation from paths."""

from pinav.fitting.langevin.checks import IncrementVerdict as IncrementVerdict
from pinav.fitting.langevin.checks import LangevinChecks as LangevinChecks
from pinav.fitting.langevin.checks import judge_increments as judge_increments
from pinav.fitting.langevin.diffusion import ConstantDiffusion as ConstantDiffusion
from pinav.fitting.langevin.diffusion import DiffusionField as DiffusionField
from pinav.fitting.langevin.diffusion import KernelDiffusion as KernelDiffusion
from pinav.fitting.langevin.fit import ThermalResult as ThermalResult
from pinav.fitting.langevin.fit import fit_langevin as fit_langevin
from pinav.fitting.langevin.increments import Increments as Increments
from pinav.fitting.langevin.increments import LearnedObservation as LearnedObservation
from pinav.fitting.langevin.increments import ObservedAxes as ObservedAxes
from pinav.fitting.langevin.tracking import ReferencePath as ReferencePath
from pinav.fitting.langevin.tracking import SlowReference as SlowReference
from pinav.fitting.langevin.tracking import slow_reference as slow_reference
