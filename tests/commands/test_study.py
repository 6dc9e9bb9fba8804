import dataclasses

import equinox as eqx
import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from tests.sweeps.here import here

from pinav import cli
from pinav.commands.study import StudySettings, job
from pinav.commands.study.job import (
    Study,
    StudyCell,
    StudyFit,
    cells,
    clean_data,
    fit_model,
    with_noise,
)
from pinav.commands.sweep import Sweep
from pinav.errors import FitError
from pinav.evaluation import Agreement, RolloutSummary
from pinav.files import csv_text
from pinav.runs import RunFolder
from pinav.scenarios import barrier_crossings
from pinav.trajectories import load

TINY = ("--models", "physics-only", "kernel-potential", "--held-out", "3")


@pytest.fixture(scope="module")
def clean():
    return clean_data("barrier-crossings", 3, 2)


@pytest.mark.slow
def test_more_noise_is_the_same_noise_on_the_starts_of_simulate(clean, tmp_path):
    quiet, loud = (with_noise(clean, sigma, 3).states for sigma in (0.01, 0.05))
    assert_allclose((loud - clean.states) / 5, quiet - clean.states, atol=1e-14)
    assert np.std(loud - clean.states) == pytest.approx(0.05, rel=0.1)
    assert with_noise(clean, 0.0, 3) is clean
    one = with_noise(clean.select([0]), 0.05, 3).states[0]
    assert_array_equal(one, loud[0])
    path = tmp_path / "data.npz"
    argv = ["simulate", "barrier-crossings", "--seed", "3", "--noise", "0"]
    assert cli.run([*argv, "--count", "1", "--out", str(path)]) == 0
    assert_allclose(load(path).states[0], clean.states[0], atol=1e-9)


def test_a_study_has_a_cell_for_every_model_seed_and_size():
    settings = StudySettings(models=("ude", "nn-only"), seeds=(0, 1), counts=(1, 4))
    found = [c.read(StudyCell) for c in cells("data-efficiency", "paper", settings)]
    assert len(found) == 8
    assert {(c.count, c.sigma) for c in found} == {(1, 0.02), (4, 0.02)}
    found = [c.read(StudyCell) for c in cells("noise", "paper", settings)]
    assert {c.count for c in found} == {8}
    assert {c.sigma for c in found} == set(settings.sigmas)


def test_scores_are_told_in_their_units_and_gaps_as_gaps():
    force = {
        region: Agreement(0.01 * i, 0.9 + 0.01 * i, 7)
        for i, region in enumerate(("visited", "near", "unvisited"), 1)
    }
    scores = RolloutSummary(0.2, 0.5, 0.03, 0.04, 0.25, 64)
    good = StudyFit("ude", 3, 4, 0.02, "converged", force, scores)
    bad = StudyFit("nn-only", 3, 4, 0.02, "failed: stiff")
    lost = dataclasses.replace(scores, median=0.1, high=np.inf)
    wild = StudyFit("nn-only", 3, 8, 0.05, "stalled", {}, lost)
    found = Study("noise", "swirl", (good, bad, wild))
    known = ["ude", 3, 4, 0.02, "converged", 0.01, 0.02, 0.03, 0.91, 0.2, 0.5, 0.25]
    first, second, third = job.csv_rows(found)
    assert first == known
    assert csv_text([second]) == f"nn-only,3,4,0.02,failed: stiff{',' * 7}\n"
    assert third[-3:] == [0.1, "diverged", 0.25]
    table = job.table(found)
    assert [name for name in table.header if "%)" in name] == [
        f"force {region} (%)" for region in force
    ]
    assert table.rows[0][5:8] == pytest.approx([1.0, 2.0, 3.0])
    (section,) = job.sections(found)
    picture = section.blocks[0].draw()
    by_force, by_rollout = (ax.get_lines()[0].get_xydata() for ax in picture.axes)
    assert_allclose(by_force, [(0.02, 1.0)])
    assert_allclose(by_rollout, [(0.02, 0.2)])
    few = job.sections(dataclasses.replace(found, name="data-efficiency"))[0]
    left, right = few.blocks[0].draw().axes
    assert_allclose(left.get_lines()[0].get_xydata(), [(4.0, 1.0)])
    assert_allclose(right.get_lines()[2].get_xydata(), [(8.0, 0.1)])


@pytest.fixture(scope="module")
def noise_study(tmp_path_factory):
    out = tmp_path_factory.mktemp("study") / "run"
    argv = ["study", "noise", "--out", str(out), *TINY, "--count", "1"]
    argv += ["--sigmas", "0.01", "0.1"]
    assert cli.run(argv) == 0
    return out, argv


@pytest.mark.slow
def test_workers_make_the_same_table_as_one_does(noise_study, tmp_path, capsys):
    out, argv = noise_study
    words = [str(tmp_path) if word == str(out) else word for word in argv]
    assert cli.run([*words, "--workers", "2"]) == 0
    for name in ("study.csv", "metrics.json"):
        assert (tmp_path / name).read_bytes() == (out / name).read_bytes()
    capsys.readouterr()
    assert cli.run(["study", "status", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert "4 of 4 cells, 0 failed; complete" in text
    assert text.count("done") == 4


@pytest.mark.slow
def test_a_model_that_fails_is_a_row_that_says_so(tmp_path, monkeypatch):
    def fail(*_, **__):
        raise FitError("the fit is singular")

    monkeypatch.setattr(job, "fit_model", fail)
    settings = StudySettings(models=("physics-only",), counts=(1,), held_out=3)
    folder = RunFolder.create(tmp_path, {}, overwrite=False)
    sweep = Sweep(folder, here)
    (row,) = job.study("data-efficiency", "swirl", settings, sweep).fits
    assert row.outcome == "failed: the fit is singular"
    assert row.rollouts is None
    assert np.isnan(row.force_error("visited"))


@pytest.mark.slow
def test_a_fit_of_a_study_that_diverged_is_an_error(clean):
    nan = jax.numpy.asarray(np.nan)
    broken = eqx.tree_at(lambda s: s.swimmer.drag.damping, barrier_crossings(), nan)
    with pytest.raises(FitError, match="diverged"):
        fit_model("kernel-potential", broken, clean, seed=0, max_steps=2)
