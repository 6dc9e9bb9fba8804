"""The command `pinav fit`."""

from pinav.commands.command import Command

FIT = Command(
    name="fit",
    summary="fit a model of the unknown force to trajectories",
    options="pinav.commands.fit.settings:FitOptions",
    run="pinav.commands.fit.job:run",
    title="A fitted model",
    report="pinav.commands.fit.report:fit_sections",
    resumable=True,
)
