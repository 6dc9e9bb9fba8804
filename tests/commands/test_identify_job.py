"""`pinav fit RECORDING`: from a file to a table, a verdict and a page."""

from pathlib import Path

import numpy as np
import pytest
from tests.fitted_runs import circling, standard_promotion

from pinav import cli, identification
from pinav.commands import IDENTIFY
from pinav.commands.identify import IdentifyOptions
from pinav.commands.identify.job import estimate_row, sections
from pinav.commands.results import start_run
from pinav.fitting import Estimate
from pinav.identification.parameters import ESTIMATED
from pinav.identification.selection import RESIDUALS
from pinav.recordings import Reading
from pinav.report import sections_text
from pinav.runs import RunFolder
from pinav.trajectories import is_trajectories, save


def identify_file(recording, folder, *more):
    """Run the command on a recording, compared with all candidates; its folder."""
    save(recording, folder / "robot.npz", overwrite=True)
    words = ["identify", str(folder / "robot.npz"), "--candidates", "all", *more]
    with standard_promotion():
        assert cli.run([*words, "--out", str(folder / "run")]) == 0
    return folder / "run"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("selection")
    with pytest.MonkeyPatch.context() as patch:
        for name in ("Gaussian process", "potential"):  # tests/selection has kernels
            patch.delitem(RESIDUALS, name)
        return identify_file(circling(), folder)


def test_a_recording_whose_commands_ask_for_nothing_only_drifts(tmp_path, capsys):
    out = identify_file(circling(driven=False), tmp_path, "--max-tracks", "0")
    assert "The commands ask for no motion: gain" in capsys.readouterr().out
    (track,) = RunFolder.open(out).load("metrics", identification.Identification).tracks
    assert track.gain is None
    assert track.rows[0].name == "drift only"
    assert track.delay is None


def test_a_recording_without_commands(tmp_path, capsys):
    identify_file(circling(driven=False, recorded=False), tmp_path, "--max-tracks", "0")
    assert "No commands recorded: gain" in capsys.readouterr().out


def test_tracks_that_are_done_are_not_fitted_again():
    recording, fitted = circling(driven=False, recorded=False), []
    with standard_promotion():
        first = identification.identify(
            recording, on_track=lambda *done: fitted.append(done)
        )
        again = identification.identify(
            recording, done={0: first.tracks[0]}, on_track=pytest.fail
        )
    ((place, track, fit),) = fitted
    assert (place, track) == (0, first.tracks[0])
    assert again.tracks == first.tracks
    drift = first.track(first.system).system.swimmer.flow.velocity
    np.testing.assert_allclose(drift, fit.model.flow.velocity)


def test_a_run_names_the_files_that_decide_its_numbers(tmp_path):
    options = IdentifyOptions(data=(Path("film.csv"),), out=tmp_path / "run")
    reading = Reading(commands=Path("log.csv"), units={"heading": "rad"})
    kept = start_run(IDENTIFY, options, reading).config()["reading"]
    assert kept == {"commands": "log.csv", "units": {"heading": "rad"}}


def test_a_track_that_was_not_fitted_and_files_of_pinav_are_told(tmp_path):
    track = identification.IdentifiedTrack("a/1", 3.0, reason="too short")
    result = identification.Identification({"x": "um", "t": "s"}, None, (track,), {})
    assert "Not fitted: too short" in sections_text(sections(result))
    table = tmp_path / "trackpy.csv"
    table.write_text("frame,particle,x,y\n0,1,2,3\n")
    assert not is_trajectories(table)
    table.write_text("t,x,y\n0,1,2\n")
    assert is_trajectories(table)
    assert is_trajectories("missing.npz")
    assert not is_trajectories("book.xlsx")


def test_quantities_are_named_in_words_and_units_of_the_recording():
    titles = [one.title or name for name, one in ESTIMATED.items()]
    assert len(set(titles)) == len(titles)
    assert {"still", "driven", "slow"}.isdisjoint(titles)
    units = {"x": "um", "t": "s"}
    row = estimate_row("driven", Estimate(2.0, 0.1), units)
    assert row[:3] == ("wandering under a command", "um s⁻¹", 2.0)
    assert 0 < row[3] < 2.0 < row[4]  # of a logarithm
    assert estimate_row("of a new model", Estimate(1.0, 0.1), units)[1] == "?"
