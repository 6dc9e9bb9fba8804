"""`pinav discover`: the law behind the learned force of a run."""

import dataclasses

from pinav.analysis import Discovery
from pinav.analysis import discover as discover_law
from pinav.analysis.discovery.learned_fit import laplace_posterior
from pinav.commands.command import CommandResult
from pinav.commands.discover import DISCOVER
from pinav.commands.discover.settings import DiscoverOptions
from pinav.commands.force_units import units_of
from pinav.commands.results import keep
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.fitting import Posterior
from pinav.fitting.environments.choice import learned_part
from pinav.forces import as_learned_force
from pinav.identification import needs_kalman_filter
from pinav.learning.learned import Learned


def discover(run: Learned, refits: int) -> Discovery:
    """Rank the laws of a run's learned force.

    Args:
        run: of a fit.
        refits: number of laws refitted through the equations of motion.

    Raises:
        InputError: the run is no finished fit of a force.
        FitError: the learned force does not explain the trajectories.
    """
    found = discover_law(_posterior(run), run.data, refits=refits)
    return dataclasses.replace(found, units=dict(units_of(run.data, run.system)))


def _posterior(run: Learned) -> Posterior:
    """The posterior that the run stored, or one by Laplace about its model."""
    model, path = run.model, run.folder.path
    known = isinstance(model, Swimmer | OverdampedSwimmer)
    stochastic = run.system.thermal_energy is not None or "diffusion" in run.constants
    if not known or stochastic or needs_kalman_filter(run.system):
        raise InputError(
            f"{path}: laws are refitted to trajectories that follow from their starts; "
            "expected a swimmer without thermal noise, commands or wandering velocity, "
            f"got the model {run.choice.name} of system {run.system.name}"
        )
    if as_learned_force(model.environment) is None:
        raise InputError(
            f"{path}: its model has no learned force of the environment; fit a kernel "
            "or neural model"
        )
    if run.posterior is not None:
        return run.posterior
    return laplace_posterior(model, run.data, learned_part)


def run(options: DiscoverOptions) -> CommandResult:
    """Find laws as the command line does."""
    fitted = Learned.open(options.run)
    return keep(DISCOVER, fitted.folder, discover(fitted, options.refits))
