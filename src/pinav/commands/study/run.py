"""`pinav study`: the choice of the study, its run and its table."""

from pathlib import Path

from pinav.commands.command import CommandResult
from pinav.commands.study import STUDY
from pinav.commands.study.job import check, study
from pinav.commands.study.report import text
from pinav.commands.study.settings import StudyOptions
from pinav.commands.sweep import start_sweep, status_text
from pinav.sweeps import sweep_status


def run(options: StudyOptions) -> CommandResult:
    """Run a study as the command line does, or tell how far one is."""
    name, world, settings = options.name, options.scenario, options.settings
    if name == "status":
        status = sweep_status(Path(world))
        return CommandResult(status, status_text(status))
    check(name, world, settings)
    identity = {"study": name, "scenario": world}
    with start_sweep(STUDY, options, options.workers, settings, **identity) as sweep:
        metrics = study(name, world, settings, sweep)
        return CommandResult(metrics, text(metrics), sweep.folder)
