"""What a fit learned: its force, what that depends on, and the law behind it."""

from pinav.analysis.discovery.discovery import Candidate as Candidate
from pinav.analysis.discovery.discovery import Discovery as Discovery
from pinav.analysis.discovery.discovery import EstimatedConstant as EstimatedConstant
from pinav.analysis.discovery.discovery import Verdict as Verdict
from pinav.analysis.discovery.discovery import discover as discover
from pinav.analysis.discovery.force_sample import Centrality as Centrality
from pinav.analysis.discovery.force_sample import CentralTest as CentralTest
from pinav.analysis.discovery.force_sample import ForceSample as ForceSample
from pinav.analysis.discovery.force_sample import central_test as central_test
from pinav.analysis.discovery.laws import LawForce as LawForce
from pinav.analysis.entropy import EntropyProduction as EntropyProduction
from pinav.analysis.entropy import entropy_production as entropy_production
from pinav.analysis.helmholtz import HelmholtzSplit as HelmholtzSplit
from pinav.analysis.helmholtz import helmholtz_split as helmholtz_split
from pinav.analysis.helmholtz import rotational_fractions as rotational_fractions
from pinav.analysis.helmholtz import sample_forces as sample_forces
from pinav.analysis.sensitivity.influence import Influence as Influence
from pinav.analysis.sensitivity.influence import influence as influence
from pinav.analysis.sensitivity.lyapunov import LyapunovMap as LyapunovMap
from pinav.analysis.sensitivity.lyapunov import lyapunov_map as lyapunov_map
from pinav.analysis.sensitivity.rollout_study import RolloutStudy as RolloutStudy
from pinav.analysis.sensitivity.sobol import Factor as Factor
from pinav.analysis.sensitivity.sobol import SobolIndices as SobolIndices
from pinav.analysis.sensitivity.sobol import sobol_indices as sobol_indices
