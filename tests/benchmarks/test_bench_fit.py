"""The table of fits: its arithmetic, what is run again, and every contestant once."""

import csv
import json
import subprocess
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from benchmarks.fit import compare, contestants, problem, scores, table
from benchmarks.fit.contestants import BY_NAME, CONTESTANTS, Effort
from benchmarks.fit.convergence import convergence

from pinav.errors import InputError
from pinav.forces import paper_force
from pinav.scenarios import scenario

pytestmark = pytest.mark.slow


def measurement(**changed):
    seconds = {"fit_seconds": 6.0, "cold_seconds": 8.0, "full_seconds": None}
    other = {"seed": 0, "iterations": 10, "peak_mib": 500.0, "note": ""}
    scores = {"rmse": 1e-5, "force": 0.1}
    return table.Measurement(**(seconds | other | scores | changed))


def test_rows_hold_spreads_and_ratios_of_medians():
    spread = table.Spread.of([3.0, 1.0, 10.0])
    assert spread == (3.0, 1.0, 10.0)
    assert spread.text(".0f") == "3 (1 to 10)"
    assert table.Spread.of([2.0]).text(".0f") == "2"
    ours = table.row(BY_NAME["ude"], [measurement()])
    rmses = (1e-3, 2e-3, 9e-3)
    other = table.row(
        BY_NAME["paper-recipe"],
        [measurement(rmse=rmse, cold_seconds=40.0) for rmse in rmses],
    )
    assert table.ratios(other, ours) == pytest.approx((200.0, 5.0))
    (line,) = table.verdicts([other, ours])
    assert "5.0 times faster, 200 times more accurate; meets 3 and 40" in line
    (line,) = table.verdicts(
        [table.row(BY_NAME["paper-recipe"], [measurement()]), ours]
    )
    assert "MISSES" in line
    ours = table.row(BY_NAME["positions-learn"], [measurement(force=0.01)])
    sfi = table.row(BY_NAME["sfi"], [measurement(force=0.04, rmse=7.0)])
    assert table.ratios(sfi, ours).error == pytest.approx(4.0)


def test_tables_hold_every_figure_and_mark_extrapolated_times():
    cut = measurement(full_seconds=100.0, note="cut short: 1 of 2 steps were run")
    row = table.row(BY_NAME["paper-torch"], [cut])
    assert row.fit_seconds.median == 100.0
    assert row.cold_seconds.median == 102.0
    printed = table.text([row], {})
    assert "~100.0" in printed
    assert "~102.0" in printed
    assert "~ extrapolated" in printed
    assert "cut short" in printed
    rows = [table.row(BY_NAME["ude"], [measurement()])]
    (values,) = csv.DictReader(table.as_csv(rows).splitlines())
    assert float(values["rmse_worst"]) == 1e-5
    assert float(values["cold_seconds_median"]) == 8.0


def test_a_pace_extrapolates_without_the_first_step():
    pace = problem.Pace(done=11, total=101, seconds=15.0, first=5.0)
    assert pace.full_seconds == pytest.approx(5.0 + 100 * 1.0)
    assert problem.Pace(3, 3, 7.0, 1.0).full_seconds == 7.0
    assert problem.Pace(1, 10, 2.0, 2.0).full_seconds == 20.0


def test_a_loop_stops_at_its_share_and_at_its_time():
    calls = []
    assert (
        problem.paced(lambda: calls.append(1), 8, fraction=0.5).done == 4 == len(calls)
    )
    slow = problem.paced(lambda: time.sleep(0.02), 100, seconds=0.05)
    assert 1 <= slow.done < 100
    done, full, note = problem.whole_recipe([slow])
    assert (done, full) == (slow.done, slow.full_seconds)
    assert f"{slow.done} of 100" in note


@pytest.fixture
def child(monkeypatch):
    """Stands for the process of a contestant; counts how often it was started."""
    started = []

    def run(contestant, seed, data, result, effort):
        started.append((contestant.name, seed))
        np.savez(
            result,
            curve=np.array([[1.0, 0.5], [2.0, 0.1]]),
            weights=np.zeros(1),
            centers=np.zeros((1, 2)),
            width=1.0,
            damping=0.36,
            gain=0.034,
        )
        names = ("iterations", "fit_seconds", "full_seconds", "peak_mib", "note")
        stdout = json.dumps({name: getattr(measurement(), name) for name in names})
        return subprocess.CompletedProcess([], 0, stdout, "")

    monkeypatch.setattr(compare, "_run_child", run)
    return started


def run(tmp_path, *words):
    compare.main(["--out", str(tmp_path), "--only", "ude", "ude-kernel", *words])


def test_what_is_finished_is_not_run_again(child, tmp_path, capsys):
    run(tmp_path, "--seeds", "0")
    assert child == [("ude", 0), ("ude-kernel", 0)]
    run(tmp_path, "--seeds", "0", "1")
    assert child[2:] == [("ude", 1)], "the kernel has no seed"
    assert "ours, kernel" in capsys.readouterr().out
    found = json.loads((tmp_path / "results.json").read_text())
    assert [m["seed"] for m in found["ude"]] == [0, 1]
    assert found["ude"][0]["force"] == pytest.approx(1.0), "no force at all was learned"
    assert (tmp_path / "convergence.png").exists()
    assert (tmp_path / "results.csv").exists()
    with pytest.raises(InputError, match="holds results of other steps"):
        run(tmp_path, "--adam-steps", "5")


def test_missing_and_failing_contestants_get_a_row(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(contestants.importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(
        compare,
        "_run_child",
        lambda *_: subprocess.CompletedProcess([], 3, "", "trouble\nout of luck\n"),
    )
    compare.main(
        ["--out", str(tmp_path), "--seeds", "0", "--only", "sfi", "paper-torch", "ude"]
    )
    printed = capsys.readouterr().out
    assert printed.count("skipped: pip install 'pinav[bench]'") == 2
    assert "failed: exit status 3: out of luck" in printed
    assert not list(tmp_path.glob("ude-*.json"))


def test_every_contestant_names_a_function():
    names = [contestant.train for contestant in CONTESTANTS]
    assert len(set(names)) == len(names) == len(BY_NAME)
    assert set(contestants.OURS.values()) <= set(BY_NAME)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("problems")
    return {
        name: problem.Problem.read(
            compare.problem_file(name, 0, folder), began=time.time()
        )
        for name in ("paper", "barrier-crossings")
    }


def test_what_goes_to_the_parent_is_the_same_model_there():
    known = scenario("paper").truth
    model = known.with_environment(paper_force(jax.random.key(3)))
    layers = [(layer.weight, layer.bias) for layer in model.environment.network.layers]
    again = scores.rebuilt(known, problem.network_arrays(layers))
    assert eqx.tree_equal(again.environment, model.environment)
    kernel = {"weights": np.zeros(1), "centers": np.zeros((1, 2)), "width": 1.0}
    arrays = {name: np.asarray(value) for name, value in kernel.items()}
    arrays |= {"damping": np.asarray(0.5), "thrust": np.asarray(0.034)}
    swimmer = scores.rebuilt(known, arrays)
    x = jnp.zeros(2)
    assert jnp.allclose(swimmer.propulsion(0.0, x, x), known.propulsion(0.0, x, x))
    assert swimmer.drag.damping == 0.5


def test_the_rate_for_diffrax_is_that_of_the_swimmer(data):
    from benchmarks.fit import diffrax_adam

    model = scenario("paper").swimmer.with_environment(paper_force(jax.random.key(5)))
    network = diffrax_adam.untrained(5)
    y = jnp.array([1.0, 2.0, -0.5, 0.7])
    rate = diffrax_adam.vector_field(data["paper"])(jnp.asarray(3.0), y, network)
    assert jnp.allclose(rate, model(jnp.asarray(3.0), y), atol=1e-12)


LITTLE = Effort(adam_steps=2, lbfgs_steps=1, gauss_newton_steps=1, seconds=60.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["paper-recipe", "ude", "ude-kernel", "positions", "paper-diffrax"]
)
def test_contestants_train(name, data):
    import importlib

    chosen = BY_NAME[name]
    module, function = chosen.train.split(":")
    train = getattr(importlib.import_module(f"benchmarks.fit.{module}"), function)
    # optax's line search takes long to compile within diffrax: Adam alone there
    effort = LITTLE if name != "paper-diffrax" else Effort(adam_steps=2, lbfgs_steps=0)
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        trained = train(data[chosen.scenario], 0, effort)
    known = scenario(chosen.scenario).truth
    force = scores.rebuilt(known, trained.arrays).environment
    x = jnp.array([4.0, 4.0])
    assert jnp.all(jnp.isfinite(force(0.0, x, jnp.zeros(2))))
    assert trained.iterations >= 1
    assert trained.full_seconds is None
    if len(trained.curve):
        assert np.all(np.diff(trained.curve[:, 0]) > 0)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_torch_trains(data):
    pytest.importorskip("torchdiffeq")
    from benchmarks.fit import torch_adam

    trained = torch_adam.train(data["paper"], 0, Effort(adam_steps=1, lbfgs_steps=1))
    assert trained.iterations == 2
    assert trained.arrays["weight0"].shape == (32, 3)


def test_error_falls_along_the_axes_of_the_figure():
    ax = convergence({"ude": np.array([[1.0, 1.0], [10.0, 1e-5]])})
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    assert "[s]" in ax.get_xlabel()
    assert ax.get_ylabel() == "total RMSE"
    heights = [line.get_ydata()[0] for line in ax.get_lines()]
    assert 0.015 in heights
