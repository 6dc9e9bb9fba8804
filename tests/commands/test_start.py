"""The start of a run: what its folder says of the settings."""

from pathlib import Path

from pinav.commands import IDENTIFY
from pinav.commands.identify import IdentifyOptions
from pinav.commands.results import start_run
from pinav.recordings import Reading


def test_a_run_names_the_files_that_decide_its_numbers(tmp_path):
    options = IdentifyOptions(data=(Path("film.csv"),), out=tmp_path / "run")
    recording = Reading(commands=Path("log.csv"), units={"heading": "rad"})
    folder = start_run(IDENTIFY, options, recording)
    assert folder.config()["reading"] == {
        "commands": "log.csv",
        "units": {"heading": "rad"},
    }
