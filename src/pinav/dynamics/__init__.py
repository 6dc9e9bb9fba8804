"""Equations of motion of swimmers, and their solvers."""

from pinav.dynamics.brownian import BOLTZMANN as BOLTZMANN
from pinav.dynamics.brownian import BrownianSwimmer as BrownianSwimmer
from pinav.dynamics.brownian import sample_path as sample_path
from pinav.dynamics.brownian import stokes_drag as stokes_drag
from pinav.dynamics.brownian import thermal_energy as thermal_energy
from pinav.dynamics.rollout import Outcome as Outcome
from pinav.dynamics.rollout import Rollout as Rollout
from pinav.dynamics.rollout import rollout as rollout
from pinav.dynamics.solvers import RK4 as RK4
from pinav.dynamics.solvers import TSIT5 as TSIT5
from pinav.dynamics.solvers import AbstractSolver as AbstractSolver
from pinav.dynamics.solvers import Adaptive as Adaptive
from pinav.dynamics.solvers import FixedStep as FixedStep
from pinav.dynamics.solvers import InterpolatingAdjoint as InterpolatingAdjoint
from pinav.dynamics.solvers import Tableau as Tableau
from pinav.dynamics.solvers import VectorField as VectorField
from pinav.dynamics.solvers import linear_recursion as linear_recursion
from pinav.dynamics.swimmers import AbstractDynamics as AbstractDynamics
from pinav.dynamics.swimmers import Model as Model
from pinav.dynamics.swimmers import NeuralDynamics as NeuralDynamics
from pinav.dynamics.swimmers import OverdampedSwimmer as OverdampedSwimmer
from pinav.dynamics.swimmers import Swimmer as Swimmer
from pinav.dynamics.swimmers import paper_black_box as paper_black_box
from pinav.dynamics.swimmers import with_dtype as with_dtype
