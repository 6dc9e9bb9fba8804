"""pinav: learn the unknown force on a driven microswimmer from its trajectories.

The names below are loaded when they are used, so that importing pinav is quick.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pinav.analysis import analyse as analyse
    from pinav.analysis import discover as discover
    from pinav.commands.explore.job import explorer as explorer
    from pinav.commands.export.job import datatree_of as datatree_of
    from pinav.dynamics import OverdampedSwimmer as OverdampedSwimmer
    from pinav.dynamics import Swimmer as Swimmer
    from pinav.dynamics import rollout as rollout
    from pinav.errors import FitError as FitError
    from pinav.errors import InputError as InputError
    from pinav.evaluation import estimate_starts as estimate_starts
    from pinav.evaluation import evaluate as evaluate
    from pinav.evaluation import field_map as field_map
    from pinav.evaluation import predict as predict
    from pinav.evaluation import score as score
    from pinav.fitting import fit as fit
    from pinav.fitting import fit_bayes as fit_bayes
    from pinav.fitting import fit_langevin as fit_langevin
    from pinav.fitting import kernel_environment as kernel_environment
    from pinav.forces import AbstractForce as AbstractForce
    from pinav.forces import ConstantForce as ConstantForce
    from pinav.forces import GaussianBarrier as GaussianBarrier
    from pinav.forces import HarmonicTrap as HarmonicTrap
    from pinav.forces import KernelForce as KernelForce
    from pinav.forces import KernelPotential as KernelPotential
    from pinav.forces import LinearDrag as LinearDrag
    from pinav.forces import RollingPropulsion as RollingPropulsion
    from pinav.forces import ZeroForce as ZeroForce
    from pinav.identification import identify as identify
    from pinav.learning.learn import learn as learn
    from pinav.learning.learn import open_run as open_run
    from pinav.learning.learned import Learned as Learned
    from pinav.navigation import Way as Way
    from pinav.navigation import navigate as navigate
    from pinav.recordings import Reading as Reading
    from pinav.recordings import read_recording as read_recording
    from pinav.scenarios import find_system as find_system
    from pinav.scenarios import scenario as scenario
    from pinav.systems import System as System
    from pinav.systems import read_system as read_system
    from pinav.systems import write_system as write_system
    from pinav.trajectories import Trajectories as Trajectories
    from pinav.trajectories import load as load
    from pinav.trajectories import save as save
    from pinav.trajectories import simulate as simulate
    from pinav.trajectories import split as split

__version__ = "0.1.0"

_PUBLIC = {
    "analysis": ("analyse", "discover"),
    "commands.explore.job": ("explorer",),
    "commands.export.job": ("datatree_of",),
    "dynamics": ("OverdampedSwimmer", "Swimmer", "rollout"),
    "errors": ("FitError", "InputError"),
    "evaluation": ("estimate_starts", "evaluate", "field_map", "predict", "score"),
    "fitting": ("fit", "fit_bayes", "fit_langevin", "kernel_environment"),
    "forces": (
        *("AbstractForce", "ConstantForce", "GaussianBarrier", "HarmonicTrap"),
        *("KernelForce", "KernelPotential", "LinearDrag", "RollingPropulsion"),
        "ZeroForce",
    ),
    "learning.learn": ("learn", "open_run"),
    "learning.learned": ("Learned",),
    "identification": ("identify",),
    "navigation": ("Way", "navigate"),
    "recordings": ("Reading", "read_recording"),
    "scenarios": ("find_system", "scenario"),
    "systems": ("System", "read_system", "write_system"),
    "trajectories": ("Trajectories", "load", "save", "simulate", "split"),
}
_HOMES = {name: home for home, names in _PUBLIC.items() for name in names}


def __getattr__(name: str) -> Any:
    """A public name from the module that holds it, loaded at its first use."""
    if name not in _HOMES:
        raise AttributeError(f"module 'pinav' has no attribute {name!r}")
    return getattr(importlib.import_module(f"pinav.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    """The public names."""
    return sorted([*_HOMES, "__version__"])
