"""`pinav design`: its words, and runs from end to end."""

import csv
import json

import pytest


@pytest.mark.slow
def test_designs_are_compared_and_recordings_are_continued(tmp_path, printed):
    ends = ("--from=1,5", "--to=9,5", "--tolerance", "0.5", "--thrust", "1.5")
    words = ("design", "shear", *ends, "--arena=0,0,10,10")
    few = ("--seeds", "1", "--most", "2", "--duration", "2", "--designs", "informed")
    found = json.loads(printed(*words, *few, "--json", "--out", tmp_path / "campaigns"))
    assert found["designs"]["informed"]["campaigns"] == 1
    assert (tmp_path / "campaigns" / "report.html").exists()

    data, out = tmp_path / "data.csv", tmp_path / "next"
    printed("simulate", "shear", "--out", data, "--noise", "0.02")
    said = printed(*words, "--data", data, "--out", out)
    assert "trajectories the force" in said
    with (out / "next.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["t", "frequency", "heading"]
    assert float(rows[-1]["t"]) == pytest.approx(5.0)
