"""What a fit learned: maps and splits of its force, and what they depend on."""

from pinav.analysis.helmholtz import HelmholtzSplit as HelmholtzSplit
from pinav.analysis.helmholtz import helmholtz_split as helmholtz_split
from pinav.analysis.helmholtz import rotational_fractions as rotational_fractions
from pinav.analysis.helmholtz import sampled_forces as sampled_forces
from pinav.analysis.influence import Influence as Influence
from pinav.analysis.influence import influence as influence
from pinav.analysis.outcomes import RolloutStudy as RolloutStudy
from pinav.analysis.sobol import Factor as Factor
from pinav.analysis.sobol import SobolIndices as SobolIndices
from pinav.analysis.sobol import sobol_indices as sobol_indices
from pinav.analysis.stretching import StretchMap as StretchMap
from pinav.analysis.stretching import start_jacobians as start_jacobians
from pinav.analysis.stretching import stretch_map as stretch_map
