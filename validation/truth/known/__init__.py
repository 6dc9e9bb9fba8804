"""Truths that are known apart from any regression on increments."""

from validation.truth.known.ring import RingTruth as RingTruth
from validation.truth.known.ring import ring_truth as ring_truth
from validation.truth.known.ring import steady_state as steady_state
from validation.truth.known.traps import TrapTruth as TrapTruth
from validation.truth.known.traps import measured_lag as measured_lag
from validation.truth.known.traps import trap_truth as trap_truth
from validation.truth.known.wall import WallScore as WallScore
from validation.truth.known.wall import boltzmann_force as boltzmann_force
from validation.truth.known.wall import brenner_mobility as brenner_mobility
from validation.truth.known.wall import wall_score as wall_score
