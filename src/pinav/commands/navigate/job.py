"""`pinav navigate`: plan on a learned force, and try it in closed loop."""

from functools import partial

from pinav.commands import NAVIGATE
from pinav.commands.command import CommandResult
from pinav.commands.navigate import NavigateOptions
from pinav.commands.navigate.cells import (
    navigation_problem,
    online_problem,
    sweep_flights,
    sweep_loops,
)
from pinav.commands.results import keep, start_run
from pinav.commands.settings import ALONE
from pinav.commands.sweep import start_sweep
from pinav.learning.learned import Learned
from pinav.navigation import OnlineNavigation, compare_models


def run(options: NavigateOptions) -> CommandResult:
    """Navigate as the command line does."""
    settings, run = options.settings, options.run
    if run is None or options.online.learn_online is not None:
        return _learn_online(options)
    settings.places()  # before the run is read, which takes seconds
    problem = navigation_problem(settings, Learned.open(run))
    compare = partial(compare_models, problem, seeds=settings.seeds, seed=settings.seed)
    if options.workers == ALONE:
        folder = start_run(NAVIGATE, options, settings, fitted=run.name)
        return keep(NAVIGATE, folder, compare())
    with start_sweep(
        NAVIGATE, options, options.workers, settings, fitted=run.name
    ) as sweep:
        found = compare(attempts=partial(sweep_loops, sweep, settings, run))
        return keep(NAVIGATE, sweep.folder, found)


def _learn_online(options: NavigateOptions) -> CommandResult:
    settings, learning, prior = options.settings, options.online, options.run
    problem = online_problem(settings, learning, prior)
    identity = {} if prior is None else {"prior": prior.name}
    with start_sweep(
        NAVIGATE, options, options.workers, settings, learning, **identity
    ) as sweep:
        found = OnlineNavigation.of(
            problem.adaptive,
            sweep_flights(sweep, settings, learning, prior),
            own_limit=problem.own_limit,
            units=problem.units,
        )
        return keep(NAVIGATE, sweep.folder, found)
