"""The command `pinav fit`."""

from pinav.commands.command import Command

FIT = Command(
    name="fit",
    summary="fit a model of the unknown force to trajectories",
    options="pinav.commands.fit.settings:FitOptions",
    run="pinav.commands.fit.job:run",
    title="A fitted model",
    result="pinav.learning.findings:Findings",
    file="metrics",
    sections="pinav.commands.fit.sections:sections",
    resumable=True,
)
