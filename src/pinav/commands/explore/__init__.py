"""The command `pinav explore`."""

from pinav.commands.command import Command

EXPLORE = Command(
    name="explore",
    summary="write a page in which the model of a run is tried by hand",
    options="pinav.commands.explore.settings:ExploreOptions",
    run="pinav.commands.explore.job:run",
    report="pinav.commands.explore.document:explorer_sections",
)
