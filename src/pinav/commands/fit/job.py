"""`pinav fit`: one model of the unknown, fitted to given data."""

import dataclasses

from pinav.commands import FIT
from pinav.commands.command import CommandResult
from pinav.commands.data_file import read_data
from pinav.commands.fit import FitOptions
from pinav.commands.many_files import run_files
from pinav.commands.progress import Reporter
from pinav.commands.results import fingerprint, keep, start_run
from pinav.learning.account import account
from pinav.learning.learn import infer
from pinav.learning.learned import Learned, is_written
from pinav.learning.plan import FitPlan, choose_system, plan_fit
from pinav.runs import RunFolder


def run(options: FitOptions) -> CommandResult:
    """Fit as the command line does."""
    file = options.file
    if file is None:
        return run_files(FIT, options)
    settings = options.settings
    data = read_data(file, options.reading)
    plan = plan_fit(
        choose_system(settings.system, data),
        data,
        model=settings.model,
        recipe=options.recipe,
        train=settings.train,
        seed=settings.seed,
        width=settings.width,
        depth=settings.depth,
    )
    identity = {"data": fingerprint(plan.data), "system": plan.system.name}
    settings_of_run = (settings, options.recipe, options.reading)
    folder = start_run(FIT, options, *settings_of_run, **identity)
    return keep(FIT, folder, fit(plan, folder).findings)


def fit(plan: FitPlan, folder: RunFolder) -> Learned:
    """Fit and write the result; what the folder holds is not done again.

    Raises:
        FitError: the fit diverged, or the data do not determine it.
    """
    if is_written(folder):
        learned = Learned.open(folder.path)
    else:
        name = plan.choice.name
        with Reporter(folder, name) as report:
            checkpoint = folder.checkpoint(name)
            learned = infer(plan, checkpoint=checkpoint, on_progress=report)
        learned = learned.write(folder)
    return dataclasses.replace(learned, found=account(plan, learned))
