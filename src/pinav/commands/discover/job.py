"""`pinav discover`: the law behind the learned force of a run."""

from pinav.analysis import discover
from pinav.commands import DISCOVER
from pinav.commands.command import CommandResult
from pinav.commands.discover import DiscoverOptions
from pinav.commands.results import keep
from pinav.learning.learned import Learned


def run(options: DiscoverOptions) -> CommandResult:
    """Find laws as the command line does."""
    fit = Learned.open(options.run)
    return keep(DISCOVER, fit.folder, discover(fit, refits=options.refits))
