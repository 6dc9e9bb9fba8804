"""`pinav export`: the learned force in the formats of other programs."""

import csv
import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pinav import cli
from pinav.commands.export.job import datatree_of, force_sds, learned_force, spot_table
from pinav.dynamics import paper_black_box
from pinav.errors import InputError
from pinav.learning.learned import Learned
from pinav.recordings import read_recording


@pytest.fixture(scope="module")
def kernel_run(fitted_runs, tmp_path_factory):
    """Read only."""
    return fitted_runs.copy("kernel", tmp_path_factory.mktemp("export"))[0]


def export(run, to, out, *more):
    words = ["export", str(run), "--to", to, "--out", str(out), *more]
    return cli.run(words)


def test_a_spot_has_the_force_of_the_model_and_its_deviation(kernel_run):
    run = Learned.open(kernel_run)
    table = spot_table(run)
    x = table.position[7]
    force = run.model.environment(jnp.asarray(0.0), jnp.asarray(x), jnp.zeros(2))
    np.testing.assert_allclose(table.force[7], force, rtol=1e-6)
    np.testing.assert_allclose(table.force_sd[7], run.posterior.force_sd(x[None])[0])
    assert len(table.time) == run.data.observed[..., :2].all(-1).sum()


def test_trackers_get_frames_in_whole_numbers_and_y_before_x(kernel_run, tmp_path):
    out = tmp_path / "tracks.csv"
    assert export(kernel_run, "napari", out) == 0
    with open(out, encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0])[:4] == ["ID", "T", "Y", "X"]
    table = spot_table(Learned.open(kernel_run))
    assert [int(row["T"]) for row in rows] == table.frame.tolist()
    assert [float(row["Y"]) for row in rows] == table.position[:, 1].tolist()
    assert [float(row["force_x"]) for row in rows] == table.force[:, 0].tolist()
    out = tmp_path / "spots.csv"
    assert export(kernel_run, "trackmate", out) == 0
    back = read_recording(out)
    data = Learned.open(kernel_run).data
    for piece, original in zip(back, data, strict=True):
        np.testing.assert_allclose(piece.times, original.times, atol=1e-12)
        np.testing.assert_allclose(np.abs(piece.states), np.abs(original.states[:, :2]))


def test_lost_frames_are_counted_but_not_written(fitted_run):
    run = Learned.open(fitted_run("positions")[0])
    table = spot_table(run)
    first = table.frame[table.trajectory == 0]
    assert len(first) == run.data.lengths[0] == 60


def test_a_run_without_a_posterior_leaves_the_deviations_empty(fitted_run, tmp_path):
    out = tmp_path / "tracks.csv"
    assert export(fitted_run("network")[0], "napari", out) == 0
    with open(out, encoding="utf-8") as file:
        assert {row["force_x_sd"] for row in csv.DictReader(file)} == {""}


def test_the_deviation_of_a_static_force_does_not_depend_on_time(kernel_run):
    run = Learned.open(kernel_run)
    force, points = learned_force(run), np.array([[5.0, 5.0], [4.0, 6.0]])
    early, late = (force_sds(run.posterior, force, points, t) for t in np.zeros((2, 2)))
    np.testing.assert_array_equal(early, late)
    assert np.isnan(force_sds(None, force, points, np.zeros(2))).all()


def test_a_run_is_not_read_in_single_precision(kernel_run):
    run = Learned.open(kernel_run)
    with jax.enable_x64(new_val=False):
        with pytest.raises(InputError, match=r"opening a run needs .*jax_enable_x64"):
            Learned.open(kernel_run)
        with pytest.raises(InputError, match=r"posterior needs float64: call jax\."):
            datatree_of(run)


@pytest.mark.extras("xarray", "h5netcdf")
def test_a_tree_of_datasets_comes_back_as_it_was(kernel_run, tmp_path):
    import xarray

    out = tmp_path / "run.nc"
    more = ("--draws", "400", "--points", "6", "--seed", "3")
    assert export(kernel_run, "netcdf", out, *more) == 0
    run = Learned.open(kernel_run)
    tree = datatree_of(run, draws=400, points=6, seed=3)
    with xarray.open_datatree(out, engine="h5netcdf") as back:
        xarray.testing.assert_identical(back.load(), tree)
    force = tree["predictions/force"]
    assert force.dims == ("chain", "draw", "x", "y", "axis")
    spread = force.std(("chain", "draw")) / tree["predictions/force_sd"]
    assert 0.85 < float(spread.min()) < float(spread.max()) < 1.15
    damping = run.constants["damping"]
    drawn = tree["posterior/damping"]
    assert abs(float(drawn.mean()) - damping.value) < 4 * damping.sd / 20
    assert float(drawn.std()) == pytest.approx(damping.sd, rel=0.15)
    observed = tree["observed_data/x"].values
    np.testing.assert_array_equal(observed[0], run.data.states[0, :, 0])
    assert np.isfinite(tree["constant_data/t"].values).all()


@pytest.mark.extras("xarray", "h5netcdf", "arviz_base", "arviz_stats")
def test_arviz_summarises_the_posterior(kernel_run):
    import arviz_base
    import arviz_stats

    tree = datatree_of(Learned.open(kernel_run), draws=400, points=4, seed=3)
    drawn = arviz_base.extract(tree, var_names="damping")
    row = arviz_stats.summary(tree, var_names="damping", round_to="none").iloc[0]
    assert drawn.sizes["sample"] == 400
    damping = Learned.open(kernel_run).constants["damping"]
    assert abs(row["mean"] - damping.value) < 4 * damping.sd / 20
    assert row["sd"] == pytest.approx(damping.sd, rel=0.15)
    assert 200 < row["ess_bulk"] < 800  # the draws are independent


def test_a_file_that_is_there_is_kept(kernel_run, tmp_path, refused):
    out = tmp_path / "there.csv"
    out.write_text("mine")
    message = "exists already; choose another name, or replace it by --overwrite"
    refused(["export", kernel_run, "--to", "napari", "--out", out], message)
    assert out.read_text() == "mine"


def test_a_model_without_a_force_is_refused(kernel_run):
    black_box = paper_black_box(key=jax.random.key(0))
    run = dataclasses.replace(Learned.open(kernel_run), models={"model": black_box})
    with pytest.raises(InputError, match=r"learned no force; fit one with"):
        spot_table(run)


def test_a_package_that_is_not_installed_is_named(
    kernel_run, tmp_path, refused, monkeypatch
):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    message = "h5netcdf is not installed; install it by pip install 'pinav[exchange]'"
    words = ["export", kernel_run, "--to", "netcdf", "--out", tmp_path / "run.nc"]
    refused(words, message)
