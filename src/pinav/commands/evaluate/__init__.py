"""The command `pinav evaluate`."""

from pinav.commands.command import Command

EVALUATE = Command(
    name="evaluate",
    summary="say where a fitted run can be trusted, on other trajectories",
    options="pinav.commands.evaluate.settings:EvaluateOptions",
    run="pinav.commands.evaluate.job:run",
    result="pinav.evaluation:Evaluation",
    file="evaluation",
    sections="pinav.commands.evaluate.sections:sections",
)
