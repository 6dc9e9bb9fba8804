"""`pinav fit FILE...` and `pinav identify FILE...`: one run each, and one table."""

import csv
import json
import shutil

import pytest

from pinav.commands import FIT
from pinav.commands.fit import FitOptions
from pinav.commands.sweep import _cell, _numbers


def test_a_cell_of_a_file_is_its_content_and_the_options(tmp_path):
    data = tmp_path / "data.csv"
    data.write_text("t,x,y\n")
    options = FitOptions(data=(data,), out=tmp_path / "run")
    cell = _cell(FIT, options, data)
    elsewhere = FitOptions(data=(data, data), out=tmp_path / "other", resume=True)
    assert _cell(FIT, elsewhere, data) == cell
    data.write_text("t,x,y\n0,0,0\n")
    assert _cell(FIT, options, data).hash != cell.hash


def test_numbers_are_named_by_the_words_on_the_way():
    content = {"rmse": {"x": 1.0, "y": None}, "model": "ude", "rows": [1, 2]}
    assert _numbers(content) == [("rmse x", 1.0), ("rmse y", None), ("model", "ude")]


def test_a_file_that_is_given_twice_is_refused(tmp_path, refused):
    data = tmp_path / "data.csv"
    data.write_text("t,x,y\n")
    argv = ["fit", str(data), str(data), "--out", str(tmp_path / "run")]
    refused(argv, "is given twice; drop one")


@pytest.mark.slow
def test_several_files_get_a_run_each_and_one_table(
    fitted_run, tmp_path, printed, refused
):
    _, data = fitted_run("kernel")
    shutil.copy(data, tmp_path / "good.npz")
    (tmp_path / "bad.csv").write_text("t,x\n0,oh\n")
    out = tmp_path / "runs"
    model = ["--model", "physics-only", "--train", "damping", "--max-steps", "2"]
    argv = ["fit", tmp_path / "good.npz", tmp_path / "bad.csv", "--out", out, *model]
    argv += ["--system", "barrier-crossings"]
    printed(*argv)
    with open(out / "runs.csv", encoding="utf-8") as file:
        good, bad = csv.DictReader(file)
    assert good["file"].startswith("good")
    assert good["failure"] == ""
    assert float(good["rmse x"]) > 0.0
    assert "bad.csv" in bad["failure"]
    assert (out / good["run"] / "report.html").exists()
    metrics = json.loads((out / good["run"] / "metrics.json").read_text())
    assert metrics["value"]["constants"]
    table = (out / "runs.csv").read_bytes()
    printed(*argv, "--resume", "--workers", "2")
    assert (out / "runs.csv").read_bytes() == table
    refused(["report", str(out)], "holds the runs of several files; report one")
