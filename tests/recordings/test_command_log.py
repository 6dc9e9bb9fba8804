"""A log of commands beside a tracker's file, whose clocks differ."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from pinav.errors import InputError
from pinav.recordings import Reading, read_recording


def course(rows=400):
    """Times, headings, frequencies and the path of a robot that follows them."""
    t = np.arange(rows) / 10
    heading = np.cumsum(np.random.default_rng(1).normal(size=rows)) * 0.3
    frequency = 2.0 + np.sin(0.4 * t)
    path = np.cumsum(3.0 * frequency * np.exp(1j * heading)) / 10
    return t, heading, frequency, np.concatenate([[0.0], path[:-1]])


@pytest.fixture
def files(tmp_path):
    """Writes a tracker's file and a log whose clock is ahead by a number of seconds."""

    def write(ahead, header="time [s],alpha [rad],freq [Hz]"):
        t, heading, frequency, path = course()
        rows = zip(t, path.real, path.imag, strict=True)
        tracks, log = tmp_path / "tracks.csv", tmp_path / "log.csv"
        lines = [f"{f},{a:.6g},{x:.6g},{y:.6g}" for f, (a, x, y) in enumerate(rows)]
        tracks.write_text("\n".join(["frame,t,x,y", *lines]))
        entries = zip(t + ahead, heading, frequency, strict=True)
        if header.startswith("frame"):
            entries = zip(range(len(t)), heading, frequency, strict=True)
        text = "\n".join(",".join(f"{v:.6g}" for v in entry) for entry in entries)
        log.write_text(f"{header}\n{text}")
        return tracks, log

    return write


OPTIONS = {
    "columns": {"t": "t", "x": "x", "y": "y"},
    "units": {"x": "um", "t": "s"},
    "y": "up",
}
FRAMES = {**OPTIONS, "fps": 10.0, "columns": {n: n for n in ("frame", "x", "y")}}


def test_the_offset_of_the_clocks_is_found_with_its_interval(files):
    tracks, log = files(ahead=7.3)
    data = read_recording(tracks, Reading(commands=log, **OPTIONS))
    said = data.provenance["commands"]["offset of its clock"]
    assert said["low"] < -7.3 < said["high"]
    assert abs(said["value"] + 7.3) < 0.11  # within a frame of the film
    assert said["high"] - said["low"] < 0.5
    _, heading, frequency, _ = course()
    same = np.mean(np.abs(data.commands["frequency"][0] - frequency) < 0.1)
    assert same > 0.95
    assert data.units["heading"] == "rad"
    assert "off the tracker's" in data.provenance["notes"][-1]
    assert len(heading) == data.lengths[0]


def test_frames_are_joined_as_they_are_with_their_delay_and_offset(files):
    tracks, log = files(0.0, header="frame,alpha [rad],freq [Hz]")
    data = read_recording(tracks, Reading(commands=log, **FRAMES))
    _, heading, frequency, _ = course()
    assert_allclose(data.commands["frequency"][0], frequency, atol=1e-4)
    assert_allclose(data.commands["heading"][0], heading, atol=1e-4)
    more = {"delay": 0.2, "heading_offset": 1.0}
    data = read_recording(tracks, Reading(commands=log, **more, **FRAMES))
    _, heading, frequency, _ = course()
    assert_allclose(data.commands["frequency"][0, 2:], frequency[:-2], atol=1e-4)
    assert_allclose(data.commands["heading"][0, 2:], heading[:-2] + 1, atol=1e-4)


WRONG = {
    "no commands": ("time,speed\n0,1\n", {}, r"log\.csv: expected a column of time"),
    "no time": ("alpha,freq\n0,1\n", {}, r"log\.csv: expected a column of time"),
    "frames without a rate": ("frame,freq\n0,1\n9,1\n", {}, r"counts frames; give fps"),
    "long ago": (
        "frame,freq\n10000,1\n10009,1\n",
        FRAMES,
        r"the log, 1000 to 1000.9, and the recording, 0 to 39.9, never meet",
    ),
}


@pytest.mark.parametrize(("text", "options", "message"), WRONG.values(), ids=WRONG)
def test_a_log_that_cannot_be_joined_is_refused(files, text, options, message):
    tracks, log = files(0.0)
    log.write_text(text)
    with pytest.raises(InputError, match=message):
        read_recording(tracks, Reading(commands=log, **{**OPTIONS, **options}))


def test_a_file_with_commands_takes_no_log(files, tmp_path):
    _, log = files(0.0)
    tidy = tmp_path / "tidy.csv"
    tidy.write_text("t_s,x_um,y_um,freq_hz,alpha_rad\n0,0,0,1,0\n1,1,0,1,0\n")
    with pytest.raises(InputError, match="commands: the file has commands itself"):
        read_recording(tidy, Reading(commands=log))


def test_a_log_lies_beside_the_file_that_names_it(files, tmp_path):
    tracks, log = files(0.0, header="frame,alpha [rad],freq [Hz]")
    lines = 'commands = "log.csv"\nfps = 10\n[columns]\nframe = "frame"\n'
    (tmp_path / "reading.toml").write_text(lines + 'x = "x"\ny = "y"\n')
    reading = Reading.of_words([str(tmp_path / "reading.toml")])
    assert reading.commands == log
    assert "heading" in read_recording(tracks, reading).commands
