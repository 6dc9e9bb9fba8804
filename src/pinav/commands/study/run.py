"""`pinav study`: the choice of the study, its run and its table."""

from pinav.commands.command import CommandResult
from pinav.commands.start import start_run
from pinav.commands.study import STUDY
from pinav.commands.study.job import check, study
from pinav.commands.study.paper_weakness import weakness
from pinav.commands.study.report import text
from pinav.commands.study.settings import StudyOptions


def run(options: StudyOptions) -> CommandResult:
    """Run a study as the command line does."""
    name, world, settings = options.name, options.scenario, options.settings
    check(name, world, settings)
    folder = start_run(STUDY, options, settings, study=name, scenario=world)
    if name == "paper-weakness":
        metrics = weakness(settings, folder)
    else:
        metrics = study(name, world, settings, folder)
    return CommandResult(metrics, text(metrics), folder)
