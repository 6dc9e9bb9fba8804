"""The command `pinav discover`."""

from pinav.commands.command import Command

DISCOVER = Command(
    name="discover",
    summary="find the law behind the learned force of a run",
    options="pinav.commands.discover.settings:DiscoverOptions",
    run="pinav.commands.discover.job:run",
    result="pinav.analysis:Discovery",
    file="laws",
    sections="pinav.commands.discover.sections:sections",
)
