import json

import jax
import numpy as np
import pytest

from pinav import cli
from pinav.errors import InputError
from pinav.evaluation import evaluate, field_map, force_errors
from pinav.learning.learned import Learned
from pinav.learning.plan import plan_fit
from pinav.learning.recipes import Bayes
from pinav.scenarios import barrier_crossings, scenario
from pinav.trajectories import Trajectories, load, save


def test_fit_learns_and_reports_what_was_asked(tiny_fit):
    run, _ = tiny_fit
    fit = Learned.open(run)
    assert fit.losses.values[0, -1] < fit.losses.values[0, 0]
    assert fit.outcome == "completed"
    assert fit.findings.constants.keys() == {"damping"}
    damping = fit.findings.constants["damping"]
    assert damping.value != pytest.approx(0.36, abs=1e-6)
    assert np.isnan(damping.sd)


@pytest.mark.slow
def test_evaluate_scores_the_stored_model(tiny_fit, printed):
    run, data = tiny_fit
    rmse = json.loads(printed("evaluate", run, data, "--json"))["rmse"]["model"]
    fitted = Learned.open(run).findings.rmse
    assert {name: rmse[name] for name in fitted} == fitted
    lines = printed("evaluate", run, data).splitlines()
    (heading,) = (line for line in lines if line.startswith("RMSE"))
    assert heading.split()[:5] == ["RMSE,", "training", "error", "x", "y"]


def test_resume_refuses_other_data(tiny_fit, tmp_path, refused):
    run, data = tiny_fit
    other, pieces = tmp_path / "other.npz", load(data)
    shorter = Trajectories.from_arrays(
        [piece.times[:-5] for piece in pieces],
        [piece.states[:-5] for piece in pieces],
        channels=pieces.channels,
        provenance=pieces.provenance,
    )
    save(shorter, other)
    config = ["--config", str(run / "config.toml")]
    argv = ["fit", str(other), "--out", str(run), *config, "--resume"]
    refused(argv, "holds a run with data = ")


def test_data_without_a_scenario_need_physics(tmp_path, refused):
    path = tmp_path / "plain.csv"
    path.write_text("t,x,y,vx,vy\n0,0,0,1,1\n1,1,1,1,1\n2,2,2,1,1\n")
    argv = ["fit", str(path), "--out", str(tmp_path / "run")]
    refused(argv, "--system: the data do not say which system they come from")
    path.write_text("t,x,y\n0,0,0\n1,1,1\n2,2,2\n")
    argv += ["--system", "paper", "--recipe", "curriculum"]
    refused(argv, "expected the channels x, y, vx, vy")
    path.write_text("t,x,y,vx,vy\n0,0,0,,\n1,1,1,1,1\n2,2,2,1,1\n")
    refused(argv, "or choose --recipe bayes")
    assert not (tmp_path / "run").exists()


def test_a_model_file_of_something_else_is_refused(tiny_fit, tmp_path, refused):
    run, data = tiny_fit
    copy = tmp_path / "run"
    copy.mkdir()
    (copy / "config.toml").write_bytes((run / "config.toml").read_bytes())
    refused(["evaluate", str(copy), str(data)], "holds no fitted model; give")
    (copy / "system.toml").write_bytes((run / "system.toml").read_bytes())
    (copy / "model.eqx").write_text('{"kind": "fit"}\n')
    refused(["evaluate", str(copy), str(data)], "kind: 'fit' is unknown")


@pytest.fixture(scope="module")
def inferred(fitted_runs, tmp_path_factory):
    """Short crossings as a tracker gives them: positions alone, a frame lost."""
    return fitted_runs.copy("positions", tmp_path_factory.mktemp("noisy"))[0]


@pytest.mark.slow
def test_positions_alone_give_a_force_and_its_uncertainty(inferred):
    found = Learned.open(inferred).findings
    assert (found.model, found.recipe) == ("kernel-potential", "bayes")
    assert found.noise == pytest.approx(0.02, rel=0.15)
    damping = found.constants["damping"]
    assert abs(damping.value - 0.36) < 4 * damping.sd < 0.1
    assert damping.low < damping.value < damping.high
    assert found.rmse["position"] == pytest.approx(0.02, rel=0.2)
    truth = barrier_crossings().truth.environment
    true = field_map(truth, load(inferred / "data.npz"))
    learned = found.force.learned
    np.testing.assert_array_equal(learned.distance, true.distance)
    assert force_errors(learned, true)["visited"] < 0.1
    near = true.distance < 0.35
    miss = np.abs(learned.force - true.force)[near]
    assert np.mean(miss < 3 * found.force.sd[near]) > 0.8
    page = (inferred / "report.html").read_text()
    assert "What the evidence chose" in page
    assert "Constants learned" in page


def test_an_inferred_run_is_resumed_without_fitting_again(inferred, capsys):
    config = ["--config", str(inferred / "config.toml"), "--resume"]
    data = inferred.parent / "data.npz"
    before = (inferred / "metrics.json").read_bytes()
    (inferred / "metrics.json").unlink()
    assert cli.run(["fit", str(data), "--out", str(inferred), *config]) == 0
    assert "step/s" not in capsys.readouterr().err
    assert (inferred / "metrics.json").read_bytes() == before


@pytest.mark.slow
def test_a_fit_says_the_force_error_where_the_truth_is_known(fitted_run, printed):
    run, data = fitted_run("kernel")
    config = ["--config", run / "config.toml", "--resume"]
    out = printed("fit", data, "--out", run, *config)
    assert "visited (%)  near (%)" in out
    assert "Relative L2 error of the force against the system's truth" in out


@pytest.mark.parametrize(
    ("name", "drag"), [("brownian", "a mobility"), ("anisotropic-drag", "TensorDrag")]
)
def test_physics_of_another_kind_is_refused(name, drag):
    system = scenario(name)
    nowhere = np.zeros((3, len(system.channels)))
    data = Trajectories.from_arrays(np.arange(3.0), nowhere, channels=system.channels)
    message = f"--train damping: system {name} has no .* its drag is {drag}"
    with pytest.raises(InputError, match=message):
        plan_fit(system, data, recipe=Bayes(), train=("damping",))


@pytest.mark.slow
def test_an_evaluation_has_physics_alone_beside_its_models(tiny_fit):
    run, data = tiny_fit
    with jax.numpy_dtype_promotion("standard"):
        scores = evaluate(Learned.open(run), load(data))
    for table in (scores.rmse, scores.rollouts, scores.force):
        assert list(table) == ["model", "physics-only"]
    for region in scores.force["physics-only"].values():
        assert region.error == pytest.approx(1.0)
        assert np.isnan(region.cosine)
