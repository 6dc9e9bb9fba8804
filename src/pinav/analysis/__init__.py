"""Analysis of what was learned: the law behind a learned force."""

from pinav.analysis.discovery import Candidate as Candidate
from pinav.analysis.discovery import Discovery as Discovery
from pinav.analysis.discovery import EstimatedConstant as EstimatedConstant
from pinav.analysis.discovery import Verdict as Verdict
from pinav.analysis.discovery import discover as discover
from pinav.analysis.field import Centrality as Centrality
from pinav.analysis.field import CentralTest as CentralTest
from pinav.analysis.field import ForceSample as ForceSample
from pinav.analysis.field import central_test as central_test
from pinav.analysis.laws import LawForce as LawForce
from pinav.analysis.refit import RefitOutcome as RefitOutcome
