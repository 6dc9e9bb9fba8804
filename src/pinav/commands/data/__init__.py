"""The command `pinav data`."""

from pinav.commands.command import Command

DATA = Command(
    name="data",
    summary="tell where public recordings come from, and fetch them",
    options="pinav.commands.data.settings:DataOptions",
    run="pinav.commands.data.job:run",
)
