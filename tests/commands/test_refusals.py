"""Data and runs that a command cannot use are refused before anything is computed."""

import os
import subprocess
import sys

import pytest

from pinav import cli


def complaint(words, capsys):
    """The one line of a command that ends with exit code 2."""
    capsys.readouterr()
    assert cli.run([*map(str, words)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    return lines[0]


def test_values_beyond_all_units_are_refused(tmp_path, capsys):
    rows = [f"{0.1 * k},{k * 1e200},{k * 2e200}" for k in range(30)]
    (tmp_path / "huge.csv").write_text("\n".join(["t,x,y", *rows, ""]))
    words = ("fit", tmp_path / "huge.csv", "--system", "brownian")
    words += ("--out", tmp_path / "run")
    assert "expected values up to 1e+12" in complaint(words, capsys)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("name", ["model.eqx", "data.npz"])
def test_a_report_of_a_run_without_a_file_names_it(name, fitted_run, capsys):
    run, _ = fitted_run("network")
    (run / name).unlink()
    assert f"{name} is missing" in complaint(("report", run), capsys)


def test_a_terminal_that_knows_ascii_alone_gets_the_text():
    done = subprocess.run(
        [sys.executable, "-m", "pinav", "inspect", "--help"],
        capture_output=True,
        env=os.environ | {"PYTHONIOENCODING": "ascii"},
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout
