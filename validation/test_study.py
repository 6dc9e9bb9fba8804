"""The studies and the evaluation at full size: what a fit can be trusted for."""

import json
from pathlib import Path

import pytest
from benchmarks.paper_weakness import KERNEL, UDE, Weakness
from validation.conftest import pinav, program

from pinav.commands.study.job import Study, StudyFit
from pinav.runs import RunFolder


def study(out: Path, *words: str) -> tuple[StudyFit, ...]:
    done = pinav("study", *words, "--out", str(out))
    assert done.returncode == 0, done.stderr
    print(done.stdout)
    return RunFolder.open(out).load("metrics", Study).fits


@pytest.fixture(scope="module")
def weakness(tmp_path_factory):
    out = tmp_path_factory.mktemp("weakness") / "run"
    done = program("benchmarks", "paper-weakness", "--out", str(out))
    assert done.returncode == 0, done.stderr
    print(done.stdout)
    return RunFolder.open(out).load("metrics", Weakness)


def test_the_papers_network_knows_its_trajectory_and_not_the_force(weakness):
    ude = weakness.models[UDE]
    assert weakness.own_trajectory < 1e-4
    assert ude.force["unvisited"].error > 1.0
    assert ude.rollouts.diverged > 0.25


def test_a_kernel_potential_on_eight_crossings_knows_it(weakness):
    kernel = weakness.models[KERNEL]
    assert max(one.error for one in kernel.force.values()) < 0.02
    assert kernel.rollouts.high < 0.05
    assert kernel.rollouts.diverged == 0


@pytest.fixture(scope="module")
def data_efficiency(tmp_path_factory):
    out = tmp_path_factory.mktemp("data") / "run"
    fits = study(out, "data-efficiency", "barrier-crossings")
    return {(fit.model, fit.trajectories): fit for fit in fits}


def test_more_trajectories_help_the_kernel_potential(data_efficiency):
    errors = [
        data_efficiency["kernel-potential", n].force_error("visited")
        for n in (1, 8, 32)
    ]
    assert errors[0] > errors[1] > 0.5 * errors[2]
    assert errors[2] < 0.02


def test_every_cell_has_its_row(data_efficiency):
    assert len(data_efficiency) == 42
    for (model, _), fit in data_efficiency.items():
        assert fit.outcome.startswith("failed") or fit.rollouts is not None
        if model == "physics-only":
            assert fit.force_error("visited") == pytest.approx(1.0)


def test_physics_alone_is_worse_than_the_kernel_potential_at_every_noise(
    tmp_path_factory,
):
    out = tmp_path_factory.mktemp("noise") / "run"
    models = ["--models", "kernel-potential", "physics-only"]
    fits = study(out, "noise", "barrier-crossings", *models)
    table = {(fit.model, fit.sigma): fit.rollout("median") for fit in fits}
    for sigma in (0.0, 0.005, 0.01, 0.02, 0.05, 0.1):
        kernel = table["kernel-potential", sigma]
        assert kernel < 0.2 * table["physics-only", sigma]


def test_a_fit_of_the_crossings_is_trusted_where_it_should_be(tmp_path_factory):
    folder = tmp_path_factory.mktemp("evaluate")
    for name, words in (
        ("train", ["--seed", "0"]),
        ("test", ["--seed", "5", "--count", "16"]),
        ("calibration", ["--seed", "6", "--count", "39", "--positions-only"]),
    ):
        out = ["--out", str(folder / f"{name}.npz")]
        assert pinav("simulate", "barrier-crossings", *out, *words).returncode == 0
    run = str(folder / "run")
    learn = ["--train", "damping", "gain"]
    fit = pinav("fit", str(folder / "train.npz"), "--out", run, *learn)
    assert fit.returncode == 0, fit.stderr
    words = ["--calibrate", str(folder / "calibration.npz")]
    done = pinav("evaluate", run, str(folder / "test.npz"), *words)
    assert done.returncode == 0, done.stderr
    print(done.stdout)
    found = json.loads((folder / "run" / "evaluation.json").read_text())["value"]
    assert found["force"]["model"]["visited"]["error"] < 0.02
    clean = found["rollouts"]["model"]["clean starts"]
    assert clean["beyond it"]["diverged"] == 0
    assert found["coverage"]["observations of the data"]["visited"] > 0.9
    assert all(abs(constant["z"]) < 3 for constant in found["constants"])
    assert min(found["whiteness"]["p_value"]) > 0.001
