"""What a fit learned: its force, what that depends on, and the law behind it."""

from pinav.analysis.discovery import Candidate as Candidate
from pinav.analysis.discovery import Discovery as Discovery
from pinav.analysis.discovery import EstimatedConstant as EstimatedConstant
from pinav.analysis.discovery import Verdict as Verdict
from pinav.analysis.discovery import discover as discover
from pinav.analysis.field import Centrality as Centrality
from pinav.analysis.field import CentralTest as CentralTest
from pinav.analysis.field import ForceSample as ForceSample
from pinav.analysis.field import central_test as central_test
from pinav.analysis.helmholtz import HelmholtzSplit as HelmholtzSplit
from pinav.analysis.helmholtz import helmholtz_split as helmholtz_split
from pinav.analysis.helmholtz import rotational_fractions as rotational_fractions
from pinav.analysis.helmholtz import sampled_forces as sampled_forces
from pinav.analysis.influence import Influence as Influence
from pinav.analysis.influence import influence as influence
from pinav.analysis.laws import LawForce as LawForce
from pinav.analysis.outcomes import RolloutStudy as RolloutStudy
from pinav.analysis.refit import RefitOutcome as RefitOutcome
from pinav.analysis.sobol import Factor as Factor
from pinav.analysis.sobol import SobolIndices as SobolIndices
from pinav.analysis.sobol import sobol_indices as sobol_indices
from pinav.analysis.stretching import StretchMap as StretchMap
from pinav.analysis.stretching import start_jacobians as start_jacobians
from pinav.analysis.stretching import stretch_map as stretch_map
