import csv

import equinox as eqx
import jax
import numpy as np
import pytest
from tests.samples import sample

from pinav import cli
from pinav.commands import EVALUATE
from pinav.commands.evaluate.job import sections
from pinav.commands.results import sections_of
from pinav.errors import InputError
from pinav.evaluation import Evaluation, evaluate, held_out
from pinav.evaluation.rollouts import ErrorCurve
from pinav.evaluation.setting import true_system
from pinav.learning.learned import Learned
from pinav.report import Table, as_text, sections_text
from pinav.runs import RunFolder
from pinav.scenarios import barrier_crossings, scenario
from pinav.trajectories import load, save, simulate

KEY = jax.random.key(0)


def short_shots(key, columns, samples=51):
    """Noisy crossings; of the states only the first columns are written."""
    shots = barrier_crossings(jax.random.key(key), 4)
    shots = eqx.tree_at(lambda s: s.times, shots, shots.times[:samples])
    data = simulate(shots, key=jax.random.key(key + 100))
    return data.only(data.channels[:columns])


@pytest.fixture(scope="module")
def judged(tmp_path_factory):
    """A Bayesian fit, evaluated on positions of other shots, and its bands there."""
    folder = tmp_path_factory.mktemp("judged")
    save(short_shots(1, 4), folder / "train.npz")
    save(short_shots(2, 2, 61), folder / "test.csv")
    save(short_shots(3, 2), folder / "calibration.npz")
    run = folder / "run"
    argv = ["fit", str(folder / "train.npz"), "--out", str(run), "--train", "damping"]
    assert cli.run(argv) == 0
    argv = ["evaluate", str(run), str(folder / "test.csv")]
    assert cli.run([*argv, "--calibrate", str(folder / "calibration.npz")]) == 0
    return run


@pytest.fixture(scope="module")
def metrics(judged):
    return RunFolder.open(judged).read_json("evaluation.json")["value"]


@pytest.mark.slow
def test_rollouts_begin_at_estimated_starts_and_are_told_apart_at_the_horizon(metrics):
    assert metrics["has_estimated_starts"]
    row = metrics["rmse"]["model"]
    assert "vx" not in row
    assert 0.015 < row["position"] < 0.2
    assert row["diverged"] == 0
    assert metrics["horizon"] == pytest.approx(5.0)
    sources = metrics["rollouts"]["model"]
    assert sources.keys() == {"data", "clean starts"}
    for parts in sources.values():
        assert parts.keys() == {"within the training horizon", "beyond it"}
    assert sources["clean starts"]["beyond it"]["trajectories"] == 64
    inside = sources["data"]["within the training horizon"]
    assert inside["median"] <= inside["high"]


@pytest.mark.slow
def test_the_force_is_judged_by_region(metrics):
    force = metrics["force"]["model"]
    assert force.keys() == {"visited", "near", "unvisited", "everywhere"}
    assert force["visited"]["error"] < 0.15
    assert force["visited"]["cosine"] > 0.99
    near, far = force["near"]["points"], force["unvisited"]["points"]
    assert near + far == force["everywhere"]["points"]
    assert metrics["regions"] == {"visited": 0.35, "near": 1.0}


@pytest.mark.slow
def test_bands_residuals_and_constants_are_judged(metrics):
    coverage = metrics["coverage"]
    judged = ("observations of the data", "rollouts from clean starts", "force")
    assert coverage.keys() == set(judged)
    assert coverage["observations of the data"]["visited"] > 0.85
    assert coverage["force"]["visited"] > 0.7
    white = metrics["whiteness"]
    assert white["channels"] == ["x", "y", "vx", "vy"]
    assert white["counts"][0] == 4 * 51
    assert min(white["p_value"]) > 1e-4
    (damping,) = metrics["constants"]
    assert (damping["name"], damping["true"]) == ("damping", 0.36)
    expected = (damping["value"] - 0.36) / damping["sd"]
    assert damping["z"] == pytest.approx(expected)
    assert abs(expected) < 4
    found = metrics["calibration"]
    assert "4 calibration trajectories are too few" in found["says"]
    assert (found["band"]["count"], found["covered"]) == (4, 1.0)
    assert found["data"] == "calibration.npz"


@pytest.mark.slow
def test_the_report_and_the_table_hold_the_evaluation(judged, metrics):
    page = (judged / "report.html").read_text()
    for words in ("Evaluation", "Ljung-Box Q", "nominal 95 % ban", "training horizon"):
        assert words in page
    for name in ("errors", "residuals"):
        assert (judged / "figures" / f"evaluation-{name}.svg").exists()
    with open(judged / "evaluation.csv", newline="") as file:
        stored = dict(csv.reader(file))
    error = metrics["force"]["model"]["visited"]["error"]
    assert float(stored["force/model/visited/error"]) == error
    said = sections_text(sections_of(EVALUATE, RunFolder.open(judged)))
    assert "relative L2 error (%)" in said
    assert "estimated from the first 20 samples" in said
    assert "within 0.35 of an observed position" in said


@pytest.mark.slow
def test_a_fit_from_its_own_starts_says_so(tiny_fit, printed):
    run, data = tiny_fit
    out = printed("evaluate", run, data, "--regions", "1", "3")
    assert "starts: the first sample of each trajectory" in out
    assert "Visited: within 1 of an observed position" in out
    stored = RunFolder.open(run).read_json("evaluation.json")["value"]
    assert stored["constants"][0]["sd"] is None
    assert stored["constants"][0]["z"] is None
    assert "coverage" not in stored


@pytest.mark.slow
def test_data_of_other_channels_are_refused(judged, tmp_path):
    path = tmp_path / "other.csv"
    path.write_text("t,x\n0,0\n1,1\n")
    fit = Learned.open(judged)
    with pytest.raises(InputError, match="expected the channels x, y, vx, vy of the"):
        evaluate(fit, load(path))


@pytest.mark.slow
def test_data_of_a_system_with_another_state_are_(refused):
    bead = scenario("brownian")
    data = simulate(eqx.tree_at(lambda s: s.times, bead, bead.times[:3]), key=KEY)
    with pytest.raises(InputError, match=r"'brownian', whose state is \(x, y\), but"):
        true_system(barrier_crossings(), data, data)


@pytest.mark.slow
def test_held_out_starts_are_clean_and_their_own():
    held = held_out(barrier_crossings(), until=1.0, count=3)
    assert held.times[0, -1] == pytest.approx(1.0)
    assert held.provenance["noise"] == 0.0
    shots = barrier_crossings(count=3).starts
    assert np.abs(held.states[:, 0] - shots).min() > 1e-3
    paper = held_out(scenario("paper"), until=1.0, count=3)
    np.testing.assert_array_equal(paper.states[:, 0], held.states[:, 0])
    held, again = (held_out(scenario("brownian"), until=1.0, count=3) for _ in "ab")
    assert held.states.shape[0] == 3
    assert np.isfinite(held.states).all()
    np.testing.assert_array_equal(held.states, again.states)


def test_a_table_is_aligned_on_a_terminal():
    text = as_text(Table(("what", "a"), [("one", 1.23456), ("eleven", None)], "Why."))
    assert text.splitlines() == [
        "what       a",
        "one     1.23",
        "eleven     –",
        "(Why.)",
    ]


def evaluation_of(seen):
    return sample(
        Evaluation,
        trajectories=4,
        rmse={"model": {"x": 0.1}},
        rollouts={"model": {"data": {}}},
        curves={"model": {"data": sample(ErrorCurve)}},
        num_training=seen,
    )


@pytest.mark.parametrize(
    ("seen", "name", "words"),
    [
        (0, "held-out error", "none of those that it was fitted to"),
        (1, "error, in part on training", "the run was fitted to 1"),
        (4, "training error", "These are the training data"),
    ],
)
def test_training_data_are_called_so(seen, name, words):
    said = sections_text(sections(evaluation_of(seen)))
    assert f"RMSE, {name}" in said
    assert words in said


@pytest.mark.slow
def test_evaluating_the_file_that_was_fitted_is_a_training_error(
    tiny_fit, printed, refused
):
    run, data = tiny_fit
    assert "These are the training data" in printed("evaluate", run, data)
    page = (run / "report.html").read_text(encoding="utf-8")
    assert "not fitted to" not in page
    words = ["evaluate", run, data, "--calibrate", data]
    refused(words, "training data of the run")
