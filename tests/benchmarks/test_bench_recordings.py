"""The benchmark of recordings: what it finds, and one small file through it."""

import json

import numpy as np
import pytest

from benchmarks import recordings
from pinav.identification import Identification
from pinav.runs import RunFolder


def drifter(path):
    """A table of trackpy: one particle that drifts, in pixels and frames."""
    random = np.random.default_rng(0)
    frames = np.arange(600)
    x, y = 40 + 0.2 * frames, 90 + 0.1 * frames
    lines = ["frame,particle,x,y"] + [
        f"{frame},0,{a + random.normal(0, 0.1):.3f},{b + random.normal(0, 0.1):.3f}"
        for frame, a, b in zip(frames, x, y, strict=True)
    ]
    path.parent.mkdir()
    path.write_text("\n".join(lines) + "\n")


def test_only_files_of_tracks_are_found(tmp_path):
    drifter(tmp_path / "lab" / "a.csv")
    (tmp_path / "lab" / "LICENSE.txt").write_text("free")
    found = recordings.recordings(tmp_path, "")
    assert [path.name for path in found] == ["a.csv"]


def test_every_row_is_kept_as_soon_as_it_is_there(tmp_path, monkeypatch):
    drifter(tmp_path / "lab" / "a.csv")
    drifter(tmp_path / "pond" / "b.csv")
    out, kept = tmp_path / "out", []

    def timed(file, options):
        table = options.out / "recordings.json"
        kept.append(len(json.loads(table.read_text())) if table.is_file() else 0)
        refused = {"seconds": 1.0, "reason": "none of ours"}
        return {"recording": file.name, "inspect": refused, "fit": refused}

    monkeypatch.setattr(recordings, "timed", timed)
    for _ in range(2):  # a second run replaces the first
        recordings.main(["--folder", str(tmp_path), "--out", str(out)])
    assert kept == [0, 1, 2, 1]


@pytest.mark.slow
def test_a_file_has_its_row_and_its_paths_lie_on_the_image(
    tmp_path, capsys, monkeypatch
):
    drifter(tmp_path / "lab" / "a.csv")
    monkeypatch.setitem(recordings.KNOWN, "lab", ("fps=10", "mpp=0.5"))
    out = tmp_path / "out"
    recordings.main(["--folder", str(tmp_path / "lab"), "--out", str(out)])
    (row,) = json.loads((out / "recordings.json").read_text())
    assert row["recording"] == "lab/a.csv"
    assert row["inspect"]["reason"] == row["fit"]["reason"] == ""
    assert row["chosen"] < 0.1
    assert "lab/a.csv" in capsys.readouterr().out
    run = RunFolder.open(out / "lab-a.csv" / "fit")
    (track,) = run.load("metrics", Identification).tracks
    seen = track.image_paths.whole[0]  # in pixels, y down, as in the file
    assert np.allclose(seen[-1], [40 + 0.2 * 599, 90 + 0.1 * 599], atol=1)
    one, pixels = track.paths.rollouts[0], track.image_paths.rollouts[0]
    assert np.allclose(pixels.sd, one.sd / 0.5)
    assert (out / "lab-a.csv" / "fit" / "figures" / "image-0.svg").is_file()
