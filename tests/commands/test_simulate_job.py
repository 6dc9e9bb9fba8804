"""`pinav simulate` and its options."""

import numpy as np
import pytest
from tests.fitted_runs import trap_system

from pinav import cli
from pinav.commands.simulate import job
from pinav.scenarios import source_system
from pinav.systems import Units, system_text
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


def test_positions_are_all_of_a_first_order_scenario(tmp_path):
    data = simulated(tmp_path, "--count", "1", "--positions-only", name="brownian")
    assert data.channels == ("x", "y")
    assert data.observed.all()


def test_a_system_of_ones_own_is_simulated_from_its_file(tmp_path, refused):
    system, out = tmp_path / "mine.toml", tmp_path / "data.csv"
    text = system_text(trap_system(1, base_units=Units("um", "s")))
    system.write_text(text)
    argv = ["simulate", str(system), "--out", str(out), "--count", "3", "--seed", "4"]
    assert cli.run(argv) == 0
    data = load(out)
    assert (len(data), data.channels) == (3, ("x",))
    assert data.units == {"x": "um", "t": "s"}
    assert source_system(data.provenance).dim == 1
    system.write_text(text.replace("value = 0.5", "value = -0.5"))
    message = "mine.toml: mobility: IsotropicTensor.value: expected > 0, got -0.5"
    refused([*argv[:3], tmp_path / "other.csv"], message)


@pytest.mark.parametrize("out", ["sim", "there.csv", "absent/a.npz"])
def test_a_file_that_cannot_be_written_is_refused_before_the_work(
    tmp_path, monkeypatch, refused, out
):
    monkeypatch.setattr(job, "simulate", pytest.fail)
    (tmp_path / "there.csv").write_text("t,x,y\n")
    refused(["simulate", "swirl", "--out", tmp_path / out], out.partition("/")[0])
