"""`pinav simulate` and its options."""

import numpy as np
import pytest

from pinav import cli
from pinav.commands.simulate import job
from pinav.scenarios import source_system
from pinav.trajectories import load


def simulated(folder, *options, name="swirl"):
    path = folder / f"{len(list(folder.iterdir()))}.npz"
    assert cli.run(["simulate", name, "--out", str(path), *options]) == 0
    return load(path)


def test_options_count_degrade_and_are_noted(tmp_path):
    plain = simulated(tmp_path, "--count", "2", "--seed", "3")
    assert len(plain) == 2
    assert plain.observed.all()
    assert "degradation" not in plain.provenance
    options = ("--frame-loss", "0.3", "--positions-only")
    poor = simulated(tmp_path, "--count", "2", "--seed", "3", *options)
    assert not poor.observed[..., 2:].any()
    assert 0.2 < 1 - poor.observed[..., 0].mean() < 0.4
    seen = poor.observed
    np.testing.assert_array_equal(poor.states[seen], plain.states[seen])
    steps = [note["step"] for note in poor.provenance["degradation"]]
    assert steps == ["FrameLoss", "Unobserved"]


def test_more_trajectories_begin_with_the_same(tmp_path):
    one, three = (simulated(tmp_path, "--count", n) for n in ("1", "3"))
    np.testing.assert_allclose(three.states[0], one.states[0], atol=1e-9)


def test_positions_are_all_of_a_first_order_scenario(tmp_path):
    data = simulated(tmp_path, "--count", "1", "--positions-only", name="brownian")
    assert data.channels == ("x", "y")
    assert data.observed.all()


MINE = """
dimension = 1
order = 1
mobility = 0.5
[units]
length = "um"
time = "s"
[truth]
kind = "harmonic-trap"
stiffness = 4.0
center = [0.0]
[observation]
noise = 0.01
[starts]
kind = "uniform-starts"
lower = [-1.0]
upper = [1.0]
[times]
last = 1.0
samples = 11
"""


def test_a_system_of_ones_own_is_simulated_from_its_file(tmp_path, refused):
    system, out = tmp_path / "mine.toml", tmp_path / "data.csv"
    system.write_text(MINE)
    argv = ["simulate", str(system), "--out", str(out), "--count", "3", "--seed", "4"]
    assert cli.run(argv) == 0
    data = load(out)
    assert (len(data), data.channels) == (3, ("x",))
    assert data.units == {"x": "um", "t": "s"}
    assert source_system(data.provenance).dim == 1
    system.write_text(MINE.replace("mobility = 0.5", "mobility = -0.5"))
    message = "mine.toml: mobility: expected > 0, got -0.5"
    refused([*argv[:3], tmp_path / "other.csv"], message)


@pytest.mark.parametrize("out", ["sim", "there.csv", "absent/a.npz"])
def test_a_file_that_cannot_be_written_is_refused_before_the_work(
    tmp_path, monkeypatch, refused, out
):
    monkeypatch.setattr(job, "simulate", pytest.fail)
    (tmp_path / "there.csv").write_text("t,x,y\n")
    refused(["simulate", "swirl", "--out", tmp_path / out], out.partition("/")[0])
