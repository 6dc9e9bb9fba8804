"""`pinav simulate` and its options."""

import jax
import numpy as np

from pinav import cli
from pinav.trajectories import load


def simulated(folder, *options, name="swirl"):
    path = folder / f"{len(list(folder.iterdir()))}.npz"
    with jax.numpy_dtype_promotion("standard"):
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
