"""`pinav analyse`: maps, parts and sensitivities of what a run has learned."""

import msgspec

from pinav.analysis import analyse
from pinav.commands import ANALYSE
from pinav.commands.analyse import AnalyseOptions
from pinav.commands.command import CommandResult
from pinav.commands.results import keep
from pinav.learning.learned import Learned


def run(options: AnalyseOptions) -> CommandResult:
    """Analyse as the command line does."""
    options.settings.check()
    fit = Learned.open(options.run)
    analysis = analyse(fit, **msgspec.structs.asdict(options.settings))
    return keep(ANALYSE, fit.folder, analysis)
