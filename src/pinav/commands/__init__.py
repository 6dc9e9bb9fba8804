"""The commands of the command line: one folder and one entry of `COMMANDS` for each."""

from pinav.commands.analyse.command import ANALYSE
from pinav.commands.bench.command import BENCH
from pinav.commands.compare.command import COMPARE
from pinav.commands.discover.command import DISCOVER
from pinav.commands.evaluate.command import EVALUATE
from pinav.commands.fit.command import FIT
from pinav.commands.heat.command import HEAT
from pinav.commands.identify.command import IDENTIFY
from pinav.commands.inspect.command import INSPECT
from pinav.commands.navigate.command import NAVIGATE
from pinav.commands.report.command import REPORT
from pinav.commands.reproduce.command import REPRODUCE
from pinav.commands.simulate.command import SIMULATE
from pinav.commands.study.command import STUDY

COMMANDS = (
    REPRODUCE,
    SIMULATE,
    INSPECT,
    IDENTIFY,
    FIT,
    EVALUATE,
    ANALYSE,
    COMPARE,
    DISCOVER,
    STUDY,
    HEAT,
    NAVIGATE,
    REPORT,
    BENCH,
)
"""All commands, in the order in which help lists them."""
