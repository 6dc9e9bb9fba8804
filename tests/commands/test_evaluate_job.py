import equinox as eqx
import jax
import numpy as np
import pytest
from tests.samples import sample

from pinav.commands.evaluate.job import sections
from pinav.errors import InputError
from pinav.evaluation import Evaluation, evaluate, held_out
from pinav.evaluation.rollouts import ErrorCurve
from pinav.evaluation.setting import true_system
from pinav.learning.learned import Learned
from pinav.report import Table, as_text, sections_text
from pinav.scenarios import barrier_crossings, scenario
from pinav.trajectories import load, simulate

KEY = jax.random.key(0)


@pytest.mark.slow
def test_data_of_other_channels_are_refused(fitted_run, tmp_path):
    path = tmp_path / "other.csv"
    path.write_text("t,x\n0,0\n1,1\n")
    fit = Learned.open(fitted_run("kernel")[0])
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
