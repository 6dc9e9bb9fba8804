"""The command `pinav navigate`."""

from pinav.commands.command import Command

NAVIGATE = Command(
    name="navigate",
    summary="plan and steer through the force that a run has learned",
    options="pinav.commands.navigate.settings:NavigateOptions",
    run="pinav.commands.navigate.job:run",
    title="Navigation",
    result="pinav.navigation.comparison:AbstractNavigation",
    file="metrics",
    sections="pinav.commands.navigate.sections:sections",
    resumable=True,
)
