import json
from types import SimpleNamespace

import equinox as eqx
import jax
import numpy as np
import pytest
from pinav.commands.fit.metrics import FitMetrics
from pinav.commands.fit.plan import plan_fit

from pinav import cli
from pinav.commands.fit import job, remarks
from pinav.commands.fit.settings import FitSettings
from pinav.errors import FitError, InputError
from pinav.evaluation import FieldMap, field_map, force_errors
from pinav.fitting import Cause, Outcome
from pinav.learning.learned import Learned
from pinav.runs import RunFolder
from pinav.scenarios import barrier_crossings, scenario
from pinav.trajectories import Trajectories, load, save, simulate


def test_fit_learns_and_reports_what_was_asked(tiny_fit):
    run, _ = tiny_fit
    metrics = RunFolder.open(run).read_json("metrics.json")
    assert metrics["loss"]["end"] < metrics["loss"]["start"]
    assert metrics["outcome"] == "completed"
    assert metrics["learned"].keys() == {"damping"}
    assert metrics["learned"]["damping"]["value"] != pytest.approx(0.36, abs=1e-6)
    assert metrics["learned"]["damping"]["sd"] is None


def test_a_fit_that_misses_the_data_says_the_likely_cause(monkeypatch):
    truth = scenario("paper")
    data = simulate(truth)
    monkeypatch.setattr(remarks, "diagnose", lambda model, data: Cause.CHAOS)
    far, near = {"total": 0.5}, {"total": 1e-6}
    model = truth.true_swimmer
    (sentence,) = remarks.likely_cause(data, model, "stalled", far)
    assert sentence.startswith("The likely cause of the failure: the motion is chaotic")
    assert remarks.likely_cause(data, model, "converged", far) == ()
    assert remarks.likely_cause(data, model, "stalled", near) == ()


def test_independent_rollouts_confirm_that_a_fit_converged():
    data = simulate(scenario("paper"))
    assert remarks.confirm_outcome("converged", 1e-9, data, {"total": 0.5}) == "stalled"
    assert (
        remarks.confirm_outcome("converged", 1e-9, data, {"total": 1e-5}) == "converged"
    )
    assert remarks.confirm_outcome("misfit", 1e-9, data, {"total": 0.5}) == "misfit"


@pytest.mark.parametrize(("model", "says"), [("potential", True), ("force", False)])
def test_a_potential_that_diverged_names_the_model_that_turns(
    monkeypatch, tmp_path, model, says
):
    """A vortex, fitted by a potential, ends so."""
    diverged = SimpleNamespace(outcome=Outcome.DIVERGED)
    monkeypatch.setattr(job, "fit_bayes", lambda *_, **__: diverged)
    truth = barrier_crossings(jax.random.key(0))
    settings = FitSettings(model=f"kernel-{model}", structure="free")
    plan = plan_fit(settings, truth, simulate(truth, key=jax.random.key(0)))
    with pytest.raises(FitError, match="the fit diverged: the states depart") as error:
        job._infer(plan, RunFolder.create(tmp_path / "run", {}, overwrite=False))
    assert ("choose --model kernel-mixture" in str(error.value)) == says


@pytest.mark.slow
def test_evaluate_scores_the_stored_model(tiny_fit, capsys):
    run, data = tiny_fit
    capsys.readouterr()
    assert cli.run(["evaluate", str(run), str(data), "--json"]) == 0
    rmse = json.loads(capsys.readouterr().out)["rmse"]["model"]
    fitted = RunFolder.open(run).read_json("metrics.json")["rmse"]
    assert {name: rmse[name] for name in fitted} == fitted
    assert cli.run(["evaluate", str(run), str(data)]) == 0
    heading = capsys.readouterr().out.splitlines()[0]
    assert heading.split()[:5] == ["RMSE,", "training", "error", "x", "y"]


def test_resume_refuses_other_data(tiny_fit, tmp_path, capsys):
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
    assert cli.run(argv) == cli.USAGE_ERROR
    assert "holds a run with data = " in capsys.readouterr().err


def test_data_without_a_scenario_need_physics(tmp_path, capsys):
    path = tmp_path / "plain.csv"
    path.write_text("t,x,y,vx,vy\n0,0,0,1,1\n1,1,1,1,1\n2,2,2,1,1\n")
    argv = ["fit", str(path), "--out", str(tmp_path / "run")]
    assert cli.run(argv) == cli.USAGE_ERROR
    assert (
        "--system: the data do not say which system they come from"
        in capsys.readouterr().err
    )
    path.write_text("t,x,y\n0,0,0\n1,1,1\n2,2,2\n")
    argv += ["--system", "paper", "--recipe", "curriculum"]
    assert cli.run(argv) == cli.USAGE_ERROR
    assert "expected the channels x, y, vx, vy" in capsys.readouterr().err
    path.write_text("t,x,y,vx,vy\n0,0,0,,\n1,1,1,1,1\n2,2,2,1,1\n")
    assert cli.run(argv) == cli.USAGE_ERROR
    assert "or choose --recipe bayes" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_model_file_of_something_else_is_refused(tiny_fit, tmp_path, capsys):
    run, data = tiny_fit
    copy = tmp_path / "run"
    copy.mkdir()
    (copy / "config.toml").write_bytes((run / "config.toml").read_bytes())
    assert cli.run(["evaluate", str(copy), str(data)]) == cli.USAGE_ERROR
    assert "holds no fitted model; give" in capsys.readouterr().err
    (copy / "system.toml").write_bytes((run / "system.toml").read_bytes())
    (copy / "model.eqx").write_text('{"kind": "fit"}\n')
    assert cli.run(["evaluate", str(copy), str(data)]) == cli.USAGE_ERROR
    assert "Object missing required field" in capsys.readouterr().err


@pytest.fixture(scope="module")
def noisy_positions(tmp_path_factory):
    """Short crossings as a tracker gives them: positions alone, some frames lost."""
    path = tmp_path_factory.mktemp("noisy") / "tracks.csv"
    crossings = eqx.tree_at(
        lambda s: (s.starts, s.times),
        barrier_crossings(),
        replace_fn=lambda a: a[:4] if a.ndim == 2 else a[:61],
    )
    data = simulate(crossings, key=jax.random.key(3))
    tracks = Trajectories.from_arrays(
        [np.delete(t, 7) for t in data.times],
        [np.delete(s[:, :2], 7, axis=0) for s in data.states],
        channels=("x", "y"),
        units={"x": "1", "y": "1", "t": "1"},
    )
    save(tracks, path)
    return path


@pytest.fixture(scope="module")
def inferred(noisy_positions):
    run = noisy_positions.parent / "run"
    argv = ["fit", str(noisy_positions), "--system", "barrier-crossings"]
    assert cli.run([*argv, "--out", str(run), "--train", "damping"]) == 0
    return run


@pytest.mark.slow
def test_positions_alone_give_a_force_and_its_uncertainty(inferred):
    metrics = RunFolder.open(inferred).read_json("metrics.json")
    assert (metrics["model"], metrics["recipe"]) == ("kernel-potential", "bayes")
    assert metrics["noise"] == pytest.approx(0.02, rel=0.15)
    damping = metrics["learned"]["damping"]
    assert abs(damping["value"] - 0.36) < 4 * damping["sd"] < 0.1
    assert metrics["rmse"]["position"] == pytest.approx(0.02, rel=0.2)
    arrays = RunFolder.open(inferred).read_arrays("results.npz")
    truth = barrier_crossings().truth.environment
    data = load(inferred / "data.npz")
    true = field_map(truth, data)
    learned = FieldMap(true.x, true.y, arrays["field/learned"], true.distance)
    assert force_errors(learned, true)["visited"] < 0.1
    near = true.distance < 0.35
    miss = np.abs(learned.force - true.force)[near]
    assert np.mean(miss < 3 * arrays["field/sd"][near]) > 0.8
    page = (inferred / "report.html").read_text()
    assert "What the evidence chose" in page
    assert "Constants learned" in page


def test_the_stored_posterior_is_that_of_the_fit(inferred):
    fitted = Learned.open(inferred)
    posterior = fitted.posterior
    metrics = fitted.folder.read_metrics("metrics.json", FitMetrics)
    damping = metrics.learned["damping"].value
    assert float(posterior.model.drag.damping) == pytest.approx(damping, rel=1e-12)
    assert len(posterior.samples(3, key=jax.random.key(0))) == 3


def test_an_inferred_run_is_resumed_without_fitting_again(inferred, capsys):
    config = ["--config", str(inferred / "config.toml"), "--resume"]
    data = inferred.parent / "tracks.csv"
    before = (inferred / "metrics.json").read_bytes()
    (inferred / "metrics.json").unlink()
    assert cli.run(["fit", str(data), "--out", str(inferred), *config]) == 0
    assert "step/s" not in capsys.readouterr().err
    assert (inferred / "metrics.json").read_bytes() == before


@pytest.mark.slow
def test_evaluation_shows_the_force_error_where_the_truth_is_known(tmp_path, capsys):
    data = tmp_path / "data.npz"
    assert cli.run(["simulate", "barrier-crossings", "--out", str(data)]) == 0
    argv = ["fit", str(data), "--out", str(tmp_path / "run")]
    assert cli.run(argv) == 0
    assert "force error (truth of the system): visited 0." in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "channels", "message"),
    [
        (
            "brownian",
            ("x", "y"),
            "--train damping: system brownian has no .* its drag is a mobility",
        ),
        (
            "anisotropic-drag",
            ("x", "y", "vx", "vy"),
            "--train damping: system anisotropic-drag has no .* drag is TensorDrag",
        ),
    ],
)
def test_physics_of_another_kind_is_refused(name, channels, message):
    data = Trajectories.from_arrays(
        np.arange(3.0),
        np.zeros((3, len(channels))),
        channels=channels,
        provenance={"scenario": name},
    )
    with pytest.raises(InputError, match=message):
        plan_fit(FitSettings(recipe="bayes", train=("damping",)), scenario(name), data)
