"""Tables of controllers and strategies; what a folder holds is not flown again."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from benchmarks.navigate import main
from benchmarks.navigate.gaussian_process import gaussian_process
from benchmarks.navigate.strategies import compare_strategies
from tests.samples import sample

from pinav.codec import encode
from pinav.errors import InputError
from pinav.navigation import FlightOutcome, Interval
from pinav.navigation.task import catalogue as tasks
from pinav.runs import RunFolder
from pinav.scenarios import scenario
from pinav.trajectories import FrameLoss, degrade

KEY = jax.random.key(0)


def test_finished_tasks_are_read(tmp_path, capsys):
    out = tmp_path / "bench"
    config = {"run": {"command": "bench-navigate-learn-online"}, "seeds": 2}
    folder = RunFolder.resume(out, config)
    certain = sample(FlightOutcome, regret=Interval(1.25, 1.2, 1.3))
    outcomes = {"oracle": sample(FlightOutcome), "certain": certain}
    rows = {name: encode(one).document for name, one in outcomes.items()}
    folder.write_json("learn-online-vortex.json", rows)
    compare_strategies(out, ["vortex"], 2)
    assert "1.250 (1.200–1.300)" in capsys.readouterr().out
    main(["--learn-online", "--tasks", "vortex", "--seeds", "2", "--out", str(out)])
    assert "1.250 (1.200–1.300)" in capsys.readouterr().out
    assert (out / "learn-online-vortex.csv").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("optimised")
def test_a_learned_current_serves_a_follower(tmp_path):
    """One fit and two runs; the swimmers are observed under a programme of commands."""
    out = tmp_path / "bench"
    main(["--tasks", "follow-line", "--fits", "1", "--seeds", "2", "--out", str(out)])
    rows = json.loads((out / "task-follow-line.json").read_text())["controllers"]
    assert rows["learned"]["tracking"] < rows["physics only"]["tracking"] / 3


@pytest.mark.slow
def test_gaussian_process_finds_the_force_and_nothing_far_away():
    known = scenario("barrier-crossings").true_swimmer
    data = tasks.training("barrier-weak", KEY, count=2)
    found = gaussian_process(known, data).environment
    truth = jax.vmap(lambda x: known.environment(0.0, x, x))(found.centers)
    values = jax.vmap(lambda x: found(0.0, x, x))(found.centers)
    spread = jnp.sqrt(jnp.mean(truth**2))
    assert jnp.sqrt(jnp.mean((values - truth) ** 2)) < 0.25 * spread
    far = found(0.0, jnp.full(2, 1e3), jnp.zeros(2))
    np.testing.assert_array_equal(far, 0.0)


def test_gaussian_process_needs_complete_trajectories():
    data = tasks.training("vortex", KEY, count=2)
    known = scenario("vortex-current").swimmer
    holes = degrade(data, [FrameLoss(0.2)], key=KEY)
    with pytest.raises(InputError, match="trajectory 0 is not complete, in equal time"):
        gaussian_process(known, holes)
