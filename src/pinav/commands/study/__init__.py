"""The command `pinav study`."""

from pinav.commands.command import Command

STUDY = Command(
    name="study",
    summary="compare models over the amount of data or of noise",
    options="pinav.commands.study.settings:StudyOptions",
    run="pinav.commands.study.run:run",
    title="A study of models",
    report="pinav.commands.study.report:study_sections",
    resumable=True,
)
