"""Data and runs that a command cannot use are refused before anything is computed."""

import os
import shutil
import subprocess
import sys

import numpy as np
import pytest

from pinav.errors import InputError
from pinav.fitting.environments.summary import DataSummary
from pinav.forces import KernelPotential
from pinav.learning import plan
from pinav.learning.plan import choose_system
from pinav.runs import RunFolder
from pinav.trajectories import Trajectories


def test_values_beyond_all_units_are_refused(tmp_path, refused):
    rows = [f"{0.1 * k},{k * 1e200},{k * 2e200}" for k in range(30)]
    (tmp_path / "huge.csv").write_text("\n".join(["t,x,y", *rows, ""]))
    words = ("fit", tmp_path / "huge.csv", "--system", "brownian")
    words += ("--out", tmp_path / "run")
    refused(words, "expected values up to 1e+12")


@pytest.mark.parametrize("name", ["model.eqx", "data.npz"])
def test_a_report_of_a_run_without_a_file_names_it(name, fitted_run, refused):
    run, _ = fitted_run("network")
    (run / name).unlink()
    refused(("report", run), f"{name} is missing")


def test_a_terminal_that_knows_ascii_alone_gets_the_text():
    done = subprocess.run(
        [sys.executable, "-m", "pinav", "inspect", "--help"],
        capture_output=True,
        env=os.environ | {"PYTHONIOENCODING": "ascii"},
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout


def test_data_too_large_for_the_memory_are_refused_before_they_are_fitted(monkeypatch):
    """Otherwise 50 GB are asked for after two minutes."""
    data = Trajectories.from_arrays(
        [np.arange(1000.0)], [np.zeros((1000, 2))], channels=("x", "y")
    )
    kernels = KernelPotential.with_zero_weights(np.zeros((300, 2)), 1.0)
    summary = DataSummary(2, (0.0,), (1.0,), kernels)
    plan.check_memory(data, summary)
    monkeypatch.setattr(plan, "free_memory", lambda: 1e6)
    with pytest.raises(InputError, match="1000 samples and 600 weights need about"):
        plan.check_memory(data, summary)


@pytest.mark.parametrize("command", ["analyse", "discover", "report", "explore"])
def test_a_model_of_another_run_is_not_taken_for_ones_own(command, fitted_run, refused):
    """Otherwise Equinox ends with a traceback about leaves."""
    other, _ = fitted_run("network")
    run, _ = fitted_run("kernel")
    shutil.copy(other / "model.eqx", run)
    message = "model.eqx is not the file that this run wrote; delete it and"
    refused((command, run), message)


@pytest.mark.parametrize(
    "words",
    [
        "analyse {0}",
        "discover {0}",
        "explore {0}",
        "evaluate {0} data.csv",
        "export {0} --to napari --out a.csv",
        "navigate {0} --from 1,1 --to 2,2 --out out",
    ],
)
def test_a_run_that_was_not_fitted_is_refused(words, tmp_path, monkeypatch, refused):
    (tmp_path / "data.csv").write_text("t,x,y\n0,0,0\n1,1,1\n")
    RunFolder.create(tmp_path / "run", {"run": {"command": "study"}}, overwrite=False)
    monkeypatch.chdir(tmp_path)
    refused(words.format("run").split(), "holds no fitted")


def test_data_of_an_unknown_scenario_are_fitted_with_the_system_that_is_given():
    """Otherwise the whole fit runs before the name is refused."""
    data = Trajectories.from_arrays(
        [np.arange(5.0)],
        [np.zeros((5, 2))],
        channels=("x", "y"),
        provenance={"scenario": "one of last year"},
    )
    assert choose_system("brownian", data).name == "brownian"
    with pytest.raises(InputError, match="--system: the data do not say which"):
        choose_system(None, data)


@pytest.mark.slow
def test_a_langevin_run_is_evaluated_on_its_own_data(fitted_run, printed):
    """Otherwise rollouts of a stochastic truth ask the user for a key of JAX."""
    out = printed("evaluate", *fitted_run("langevin"))
    assert "RMSE, training error" in out
    assert "do not trust it there" in out  # bands far from data rest on the prior
