"""The commands of the command line: one folder and one entry of `COMMANDS` for each."""

from pinav.commands.analyse import ANALYSE
from pinav.commands.compare import COMPARE
from pinav.commands.data import DATA
from pinav.commands.design import DESIGN
from pinav.commands.discover import DISCOVER
from pinav.commands.evaluate import EVALUATE
from pinav.commands.explore import EXPLORE
from pinav.commands.export import EXPORT
from pinav.commands.fit import FIT
from pinav.commands.heat import HEAT
from pinav.commands.identify import IDENTIFY
from pinav.commands.inspect import INSPECT
from pinav.commands.live import LIVE
from pinav.commands.navigate import NAVIGATE
from pinav.commands.report import REPORT
from pinav.commands.reproduce import REPRODUCE
from pinav.commands.simulate import SIMULATE
from pinav.commands.study import STUDY

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
    DATA,
    HEAT,
    NAVIGATE,
    DESIGN,
    LIVE,
    EXPLORE,
    EXPORT,
    REPORT,
)
"""All commands, in the order in which help lists them."""
