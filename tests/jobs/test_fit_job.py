import json

import numpy as np
import pytest

from pinav import cli
from pinav.errors import InputError
from pinav.jobs.fit import check
from pinav.jobs.settings import FitSettings
from pinav.runs import RunFolder
from pinav.trajectories import Trajectories


def test_fit_learns_and_reports_what_was_asked(tiny_fit):
    run, _ = tiny_fit
    metrics = RunFolder.open(run).read_json("metrics.json")
    assert metrics["loss"]["end"] < metrics["loss"]["start"]
    assert metrics["learned"].keys() == {"damping"}
    assert metrics["learned"]["damping"] != pytest.approx(0.36, abs=1e-6)


def test_evaluate_scores_the_stored_model(tiny_fit, capsys):
    run, data = tiny_fit
    capsys.readouterr()
    assert cli.run(["evaluate", str(run), str(data), "--json"]) == 0
    rmse = json.loads(capsys.readouterr().out)["rmse"]["model"]
    fitted = RunFolder.open(run).read_json("metrics.json")["rmse"]
    assert {name: rmse[name] for name in fitted} == fitted
    assert cli.run(["evaluate", str(run), str(data)]) == 0
    assert capsys.readouterr().out.split()[:4] == ["x", "y", "vx", "vy"]


def test_resume_refuses_other_data(tiny_fit, tmp_path, capsys):
    run, data = tiny_fit
    other = tmp_path / "other.csv"
    lines = data.read_text().splitlines()
    other.write_text("\n".join(lines[:-5]) + "\n")
    config = ["--config", str(run / "config.toml")]
    argv = ["fit", str(other), "--out", str(run), *config, "--resume"]
    assert cli.run(argv) == cli.USAGE_ERROR
    assert "holds a run with data = " in capsys.readouterr().err


def test_data_without_a_scenario_need_physics(tmp_path, capsys):
    path = tmp_path / "plain.csv"
    path.write_text("t,x,y,vx,vy\n0,0,0,1,1\n1,1,1,1,1\n2,2,2,1,1\n")
    argv = ["fit", str(path), "--out", str(tmp_path / "run")]
    assert cli.run(argv) == cli.USAGE_ERROR
    assert "--physics: the data name no scenario; give" in capsys.readouterr().err
    path.write_text("t,x,y\n0,0,0\n1,1,1\n2,2,2\n")
    assert cli.run([*argv, "--physics", "paper"]) == cli.USAGE_ERROR
    assert "expected the channels x, y, vx, vy" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_model_file_of_something_else_is_refused(tiny_fit, tmp_path, capsys):
    run, data = tiny_fit
    copy = tmp_path / "run"
    copy.mkdir()
    (copy / "config.toml").write_text("")
    assert cli.run(["evaluate", str(copy), str(data)]) == cli.USAGE_ERROR
    assert "holds no model yet; finish it with --resume" in capsys.readouterr().err
    (copy / "model.eqx").write_text('{"kind": "fit"}\n')
    assert cli.run(["evaluate", str(copy), str(data)]) == cli.USAGE_ERROR
    assert "its first line misses or misnames" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "channels", "message"),
    [
        (
            "brownian",
            ("x", "y"),
            "'brownian': expected a swimmer with inertia, got Bro",
        ),
        (
            "anisotropic-drag",
            ("x", "y", "vx", "vy"),
            "--learn damping: scenario anisotropic-drag has no .* drag is TensorDrag",
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
        check(FitSettings(learn=("damping",)), data)
