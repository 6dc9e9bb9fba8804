"""The start of a run: what its folder says of the settings."""

from pathlib import Path

from pinav.commands.identify import IDENTIFY
from pinav.commands.identify.settings import IdentifyOptions
from pinav.commands.recording_settings import RecordingSettings
from pinav.commands.results import start_run


def test_a_run_names_the_files_that_decide_its_numbers(tmp_path):
    options = IdentifyOptions(data=(Path("film.csv"),), out=tmp_path / "run")
    recording = RecordingSettings(commands=Path("log.csv"), units=("heading=rad",))
    folder = start_run(IDENTIFY, options, recording)
    assert folder.config()["commands"] == "log.csv"
    assert folder.config()["units"] == ["heading=rad"]
