"""The command `pinav truth`."""

from pinav.commands.command import Command

TRUTH = Command(
    name="truth",
    summary="judge fits on recordings whose truth is known independently",
    options="pinav.commands.truth.settings:TruthOptions",
    run="pinav.commands.truth.job:run",
    title="Verified on recordings",
    report="pinav.commands.truth.report:truth_sections",
)
