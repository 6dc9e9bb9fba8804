"""Fits of recordings, judged by what is known of them: `python -m validation.truth`."""

from pinav.commands.command import Command

TRUTH = Command(
    name="truth",
    call="python -m validation.truth",
    summary="judge fits on recordings whose truth is known independently",
    options="validation.truth.settings:TruthOptions",
    run="validation.truth.job:run",
    title="Verified on recordings",
    result="validation.truth.metrics:Truth",
    file="metrics",
    sections="validation.truth.sections:sections",
)
