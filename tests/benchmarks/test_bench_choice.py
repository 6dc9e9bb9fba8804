"""The benchmark of the choice: halves of the tracks, kept splits and its table."""

import msgspec
import numpy as np

from benchmarks import choice
from pinav.errors import InputError


def rollers(path, names):
    """A table of robots that follow their commands for 45 s, and of a short one."""
    times = np.arange(0, 45, 0.25)
    lines = ["run,particle,t_s,x_um,y_um,freq_hz,alpha_rad"]
    for name in (*names, "short"):
        for t in times[:60] if name == "short" else times:
            place = f"{2 * t:.3f},{np.sin(t):.3f},1,{0.3 * t % 3:.3f}"
            lines.append(f"{name},1,{t:.3f},{place}")
    path.write_text("\n".join(lines) + "\n")


def test_halves_share_no_track_and_leave_out_short_ones(tmp_path):
    rollers(tmp_path / "a.csv", "abcde")
    group = choice.Group("a.csv")
    halves = [
        [track.name for track in choice.half_of(tmp_path, group, half)]
        for half in ("development", "judged")
    ]
    assert halves == [["a/1", "c/1", "e/1"], ["b/1", "d/1"]]
    fewer = choice.half_of(tmp_path, choice.Group("a.csv", 2), "development")
    assert [track.name for track in fewer] == ["a/1", "e/1"]


def test_splits_that_were_done_are_kept_and_counted(tmp_path, capsys, monkeypatch):
    rollers(tmp_path / "a.csv", "ab")
    monkeypatch.setattr(choice, "GROUPS", {"a": choice.Group("a.csv")})

    def select_model(track, *, train_fraction):
        raise InputError(f"split {train_fraction} of {track.name} is not fitted")

    monkeypatch.setattr(choice, "select_model", select_model)
    done = choice.Split("a", "a/1", 0.5, "drift", 0.02, 0.04, 0.05, 0.9, 6, faster=True)
    out = tmp_path / "out"
    out.mkdir()
    (out / "a-a-1-0.5.json").write_bytes(msgspec.json.encode(done))
    choice.main(["--folder", str(tmp_path), "--out", str(out), "--groups", "a"])
    *_, group, everything, faster = capsys.readouterr().out.splitlines()
    cells = ["a", "1", "6", "0.020", "0.040", "0.50", "0", "0.050", "1", "90.0%"]
    assert group.split() == cells
    assert everything.split()[1:] == faster.split()[4:] == group.split()[1:]
