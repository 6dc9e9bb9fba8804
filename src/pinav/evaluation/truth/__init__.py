"""Truths that are known apart from any regression on increments."""

from pinav.evaluation.truth.ring import RingTruth as RingTruth
from pinav.evaluation.truth.ring import ring_truth as ring_truth
from pinav.evaluation.truth.ring import steady_state as steady_state
from pinav.evaluation.truth.traps import TrapTruth as TrapTruth
from pinav.evaluation.truth.traps import measured_lag as measured_lag
from pinav.evaluation.truth.traps import trap_truth as trap_truth
from pinav.evaluation.truth.wall import WallScore as WallScore
from pinav.evaluation.truth.wall import boltzmann_force as boltzmann_force
from pinav.evaluation.truth.wall import wall_score as wall_score
