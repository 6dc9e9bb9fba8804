"""The command `pinav analyse`."""

from pinav.commands.command import Command

ANALYSE = Command(
    name="analyse",
    summary="map what a fit learned, and what it depends on",
    options="pinav.commands.analyse.settings:AnalyseOptions",
    run="pinav.commands.analyse.job:run",
    result="pinav.analysis:Analysis",
    file="analysis",
    sections="pinav.commands.analyse.sections:sections",
)
