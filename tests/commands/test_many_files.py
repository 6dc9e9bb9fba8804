"""`pinav fit FILE...` and `pinav identify FILE...`: one run each, and one table."""

import csv
import json
import shutil

import pytest

from pinav import cli
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


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "expected a file of data, got none; give one or more"),
        (["a.csv", "--workers", "2"], "a.csv: cannot read: No such file"),
        (["a.csv", "b.csv"], "a.csv: cannot read: No such file"),
    ],
)
@pytest.mark.parametrize("command", ["fit", "identify"])
def test_mistakes_get_one_line(command, words, message, tmp_path, refused):
    refused([command, *words, "--out", tmp_path / "run"], message)


def test_a_file_that_is_given_twice_is_refused(tmp_path, refused):
    data = tmp_path / "data.csv"
    data.write_text("t,x,y\n")
    argv = ["fit", str(data), str(data), "--out", str(tmp_path / "run")]
    refused(argv, "is given twice; drop one")


@pytest.mark.slow
def test_several_files_get_a_run_each_and_one_table(
    fitted_run, tmp_path, capsys, refused
):
    _, data = fitted_run("kernel")
    shutil.copy(data, tmp_path / f"good{data.suffix}")
    (tmp_path / "bad.csv").write_text("t,x\n0,oh\n")
    out = tmp_path / "runs"
    files = [str(tmp_path / f"good{data.suffix}"), str(tmp_path / "bad.csv")]
    model = ["--model", "physics-only", "--train", "damping", "--max-steps", "2"]
    argv = ["fit", *files, "--out", str(out), "--system", "barrier-crossings", *model]
    assert cli.run(argv) == 0
    with open(out / "runs.csv", encoding="utf-8") as file:
        good, bad = csv.DictReader(file)
    assert good["file"].startswith("good")
    assert good["failure"] == ""
    assert float(good["rmse x"]) > 0.0
    assert "bad.csv" in bad["failure"]
    assert (out / good["run"] / "report.html").exists()
    assert json.loads((out / good["run"] / "metrics.json").read_text())["value"][
        "constants"
    ]
    table = (out / "runs.csv").read_bytes()
    assert cli.run([*argv, "--resume", "--workers", "2"]) == 0
    assert (out / "runs.csv").read_bytes() == table
    capsys.readouterr()
    refused(["report", str(out)], "holds the runs of several files; report one")
