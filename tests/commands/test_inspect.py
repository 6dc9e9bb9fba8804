"""`pinav inspect`, from the words of the command line to its files."""

import json
import time
from xml.etree import ElementTree

import matplotlib.image
import numpy as np
import pytest

from pinav.errors import InputError
from pinav.recordings import Reading, image_positions, read_recording
from pinav.trajectories import Trajectories, save


@pytest.fixture
def circles(tmp_path):
    """A synthetic recording of two robots under one command."""
    path = tmp_path / "circles.csv"
    lines = ["run,particle,frame,t_s,x_px,y_px,freq_hz,alpha_rad"]
    random = np.random.default_rng(0)
    for particle in (1, 2):
        noise = 0.1 * random.standard_normal((400, 2))
        for frame in range(400):
            t = frame / 20
            x = 50 * particle + 20 * np.sin(0.5 * t) + noise[frame, 0]
            y = 20 * np.cos(0.5 * t) + noise[frame, 1]
            frequency = 2 + (frame > 200)
            lines.append(f"a,{particle},{frame},{t},{x},{y},{frequency},{0.5 * t}")
    path.write_text("\n".join(lines))
    return path


def test_inspect_prints_a_table_and_writes_a_report(
    circles, tmp_path, printed, refused
):
    out = tmp_path / "report"
    argv = ["inspect", circles, "--mpp", "0.345", "--out", out]
    said = printed(*argv)
    assert "circles.csv, format tidy" in said
    assert "scatter [um]" in said
    assert "delay and heading offset are confounded" in said
    assert str(out / "inspection.html") in said
    found = json.loads((out / "inspection.json").read_text())
    assert [run["particles"] for run in found["runs"]] == [2]
    scatter = found["runs"][0]["scatter"]
    np.testing.assert_allclose(scatter, 0.1 * 0.345, rtol=0.1)
    assert Reading.of_words([str(out / "reading.toml")]) == Reading(mpp=0.345)
    page = (out / "inspection.html").read_text()
    assert "data:image/png;base64," in page
    for name in ("recording.png", "recording.svg"):
        assert (out / "figures" / name).stat().st_size > 10_000
    labels = ElementTree.parse(out / "figures" / "recording.svg").getroot().itertext()
    words = " ".join(labels)
    for part in ("paths", "speed [µm/s]", "f cos(heading) [Hz]", "interval [s]"):
        assert part in words
    refused(argv, "holds a report already; give --overwrite")
    printed(*argv, "--overwrite")


def test_inspect_prints_json_alone(circles, printed, refused):
    refused(["inspect", circles, "--format", "excel"], "format: expected one of ")
    found = json.loads(printed("inspect", circles, "--json"))
    assert found["format"] == "tidy"
    assert "positions are in pixels: give mpp" in " ".join(found["warnings"])


def test_inspect_takes_any_table_by_its_columns(tmp_path, printed):
    path = tmp_path / "own.csv"
    rows = (f"{t * 100};{t};{-t};{90 * t}" for t in range(10))
    path.write_text("\n".join(["T;A;B;W", *rows]))
    argv = ["inspect", path, "--json", "--y", "up"]
    argv += ["--columns", "t=T", "x=A", "y=B", "heading=W"]
    argv += ["--units", "t=ms", "x=um", "heading=deg", "--heading-offset", "0.5"]
    found = json.loads(printed(*argv))
    assert found["provenance"]["commands"]["heading_offset"] == 0.5
    assert found["provenance"]["positions"]["y flipped"] is False
    np.testing.assert_allclose(found["runs"][0]["duration"], 0.9)


def test_recording_without_commands_is_drawn_too(tmp_path, printed):
    path = tmp_path / "spots.csv"
    rows = (f"{f},{p},{p + 0.1 * f},{p}" for p in range(3) for f in range(30))
    path.write_text("\n".join(["frame,particle,x,y", *rows]))
    out = tmp_path / "report"
    printed("inspect", path, "--out", out)
    svg = (out / "figures" / "recording.svg").read_text()
    assert "scatter of each particle" in svg
    assert "speed [px/frame]" in svg


def test_paths_are_drawn_over_a_still_of_the_film(circles, tmp_path, printed, refused):
    still = tmp_path / "still.png"
    matplotlib.image.imsave(still, np.zeros((60, 140, 3)))
    out = tmp_path / "report"
    argv = ["inspect", circles, "--image", still]
    printed(*argv, "--mpp", "0.5", "--out", out)
    assert (out / "figures" / "overlay.png").exists()
    assert "In the image" in (out / "inspection.html").read_text()
    refused(argv, "--image: is drawn into a report; give --out")
    still.write_text("no image")
    argv += ["--out", tmp_path / "other"]
    refused(argv, "still.png: cannot be read as an image")


@pytest.mark.parametrize("y", ["down", "up"])
def test_positions_go_back_to_the_pixels_of_the_file(circles, y):
    data = read_recording(circles, Reading(mpp=0.345, y=y))
    text = circles.read_text().splitlines()[1:401]
    pixels = np.array([line.split(",")[4:6] for line in text], float)
    again = image_positions(data, data.trajectory(0).states)
    np.testing.assert_allclose(again, pixels, rtol=1e-12)


def test_positions_in_micrometres_have_no_pixels(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t_s,x_um,y_um\n0,1,2\n1,2,3\n")
    data = read_recording(path)
    with pytest.raises(InputError, match="image: positions were not read from pixels"):
        image_positions(data, data.trajectory(0).states)


REAL = {
    "magscope_cellbot_sessions/sessions.csv.gz": "--heading-offset 1.5708",
    "magscope_roller_circles/control_circles.csv.gz": "",
    "magscope_roller_circles/idle_action_data.xlsx": "--mpp 0.345",
    "magscope_speed_vs_freq/20um_roller.csv.gz": "",
    "dna_microswimmer_flow/tracks.csv.gz": "",
    "ecoli_pillars_trackmate/dev1-pil0-dis0-rep1-02022024.csv": "--fps 20 --mpp 0.656",
    "sfi_synthetic_trap/optical_tweezer.csv": "",
}


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_real_recordings_pass_without_hand_editing(recording, name, printed):
    path = recording(name)
    start = time.monotonic()
    assert path.name in printed("inspect", path, *REAL[name].split())
    assert time.monotonic() - start < 120


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_files_of_pinav_are_inspected_too(tmp_path, suffix, printed):
    times = np.arange(0, 6, 0.1)
    path = np.cumsum(np.random.default_rng(0).normal(size=(60, 2)), axis=0)
    data = Trajectories.from_arrays(
        [times, times],
        [path, path + 1],
        channels=("x", "y"),
        units={"x": "um", "y": "um", "t": "s"},
    )
    save(data, tmp_path / f"own{suffix}")
    said = printed("inspect", tmp_path / f"own{suffix}")
    assert "own" in said
    assert "no commands of frequency and heading" in said
