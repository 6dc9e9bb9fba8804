"""One recording through inspect, identify, fit, evaluate, analyse and navigate."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.fitted_runs import standard_promotion

from pinav import cli
from pinav.learning.learned import Learned
from pinav.systems import read_system
from pinav.trajectories import Trajectories, save


def robot():
    """Sixty seconds of a robot that random headings drive about a trap."""
    random = np.random.default_rng(0)
    times = np.arange(0.0, 60.0, 0.1)
    heading = np.cumsum(random.normal(0, 0.35, len(times)))
    x, path = np.zeros(2), []
    for angle, kick in zip(heading, random.normal(size=(600, 2)), strict=True):
        path.append(x)
        push = 3.0 * np.array([np.cos(angle), np.sin(angle)])
        x = x + 0.1 * (push - 0.25 * x + 0.5 * kick)
    seen = np.array(path) + 0.05 * random.normal(size=(600, 2))
    return Trajectories.from_arrays(
        [times],
        [seen],
        channels=("x", "y"),
        commands={"frequency": [np.ones(600)], "heading": [heading]},
        units={"x": "um", "y": "um", "t": "s"},
    )


@pytest.mark.slow
def test_a_recording_goes_through_all_commands_on_the_same_runs(tmp_path, capsys):
    file, response, force = (str(tmp_path / n) for n in ("robot.csv", "I", "F"))
    there = ["--from=-3,-3", "--to=4,4", "--seeds", "3", "--out", f"{force}-there"]
    save(robot(), tmp_path / "robot.csv")
    for words in (
        ["inspect", file],
        ["identify", file, "--out", response],
        ["fit", file, "--system", f"{response}/system.toml", "--out", force],
        ["evaluate", response, file],
        ["evaluate", force, file],
        ["analyse", force],
        ["navigate", force, *there],
    ):
        with standard_promotion():
            assert cli.run(words) == 0, capsys.readouterr().err
    system = read_system(tmp_path / "I" / "system.toml")
    assert system.wandering is not None
    for name in ("I", "F"):
        file = tmp_path / name / "evaluation.json"
        metrics = json.loads(file.read_text())["value"]
        assert "whiteness" not in metrics
        assert metrics["coverage"]["observations of the data"]["visited"] > 0.8
    run = Learned.open(tmp_path / "I")
    assert run.posterior is not None
    assert_allclose(run.model.propulsion.gain, system.swimmer.propulsion.gain)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["dev1-pil0-dis0", "sorted-dev1-pil3-dis1"])
def test_bacteria_that_overlap_in_time_are_identified(recording, name, tmp_path):
    file = recording(f"ecoli_pillars_trackmate/{name}-rep1-02022024.csv")
    words = ["identify", str(file), "--reading", "fps=20", "mpp=0.656"]
    with standard_promotion():
        assert cli.run([*words, "--out", str(tmp_path / "I")]) == 0
    metrics = json.loads((tmp_path / "I" / "metrics.json").read_text())
    assert not any(track["reason"] for track in metrics["value"]["tracks"])
