import numpy as np
import pytest

from pinav import cli
from pinav.errors import InputError
from pinav.learning.plan import plan_fit
from pinav.learning.recipes import Bayes
from pinav.scenarios import scenario
from pinav.trajectories import Trajectories, load, save


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
    refused(argv, "or choose the recipe bayes")
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


def test_an_inferred_run_is_resumed_without_fitting_again(inferred, capsys):
    config = ["--config", str(inferred / "config.toml"), "--resume"]
    data = inferred.parent / "data.npz"
    before = (inferred / "metrics.json").read_bytes()
    (inferred / "metrics.json").unlink()
    assert cli.run(["fit", str(data), "--out", str(inferred), *config]) == 0
    assert "step/s" not in capsys.readouterr().err
    assert (inferred / "metrics.json").read_bytes() == before


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
