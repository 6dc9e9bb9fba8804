"""The command `pinav study`."""

from pinav.commands.command import Command

STUDY = Command(
    name="study",
    summary="compare models over the amount of data or of noise",
    options="pinav.commands.study.settings:StudyOptions",
    run="pinav.commands.study.job:run",
    title="A study of models",
    result="pinav.commands.study.result:Study",
    file="metrics",
    sections="pinav.commands.study.sections:sections",
    resumable=True,
)
