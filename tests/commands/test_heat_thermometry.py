"""`pinav heat learn`, `optimise` on frames of MR thermometry: the phantom, small."""

import importlib.util
import json
import tomllib

import jax
import numpy as np
import pytest
import tomli_w
from tests.heat_cases import EXAMPLES, change, run, write

from pinav.runs import RunFolder
from pinav.thermal.case import read_case
from pinav.thermal.images import read_frames, read_image
from pinav.thermal.learned_tissue import LearnedTissue
from pinav.thermal.setup import Setup
from pinav.thermal.solve import solve

PHANTOM = EXAMPLES / "phantom.py"
SMALL = {"cells": (12, 12, 8), "size": (12e-3, 12e-3, 12e-3), "frames": 12}


@pytest.fixture(scope="module")
def phantom():
    """The example as a module."""
    spec = importlib.util.spec_from_file_location("phantom", PHANTOM)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    with jax.numpy_dtype_promotion("standard"):
        spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def folder(phantom, tmp_path_factory):
    made = tmp_path_factory.mktemp("phantom")
    with jax.numpy_dtype_promotion("standard"):
        phantom.make_phantom(made, key=5, noise=0.3, **SMALL)
    return made


def edit(folder, name, changes, to="changed.toml"):
    return write(
        folder, change(tomllib.loads((folder / name).read_text()), changes), name=to
    )


@pytest.mark.slow
@pytest.mark.extras("nibabel")
def test_the_truth_of_a_phantom_is_learned_and_predicted(
    phantom, folder, tmp_path, capsys
):
    save = phantom.ArraysIn(folder, SMALL["size"], 60.0, "nii.gz")
    save("labels", np.load(folder / "labels.npy"))
    changes = {"learn.until": 480.0, "grid.labels": "labels.nii.gz"}
    path = edit(folder, "case.toml", changes)
    out = tmp_path / "run"
    assert run("learn", path, "--out", out) == 0
    assert "perfusion of tumour [kg/(m³ s)]" in capsys.readouterr().out
    metrics = json.loads((out / "metrics.json").read_text())["value"]
    assert metrics["noise"] == pytest.approx(1.0, abs=0.05)
    for name, one in metrics["quantities"].items():
        assert abs(one["value"] - metrics["true"][name]) < 4 * one["sd"], name
    assert metrics["forecast"]["fitted_until"] == 480.0
    assert metrics["forecast"]["residual"] == pytest.approx(1.0, abs=0.05)
    assert metrics["forecast"]["error"] < 0.5
    figures = {p.stem for p in (out / "figures").glob("*.svg")}
    assert figures == {"heat-means", "heat-frame", "heat-forecast"}
    fit, reading = (read_image(out / f"{name}.nii.gz") for name in ("fit", "reading"))
    labels = read_image(folder / "labels.nii.gz")
    assert fit.affine == pytest.approx(labels.affine)
    assert np.nanstd(fit.values - reading.values) == pytest.approx(0.3, rel=0.2)


@pytest.mark.slow
def test_the_rest_of_a_protocol_is_planned_and_judged(folder, tmp_path, capsys):
    changes = {"optimise.after": 480.0, "optimise.max_temperature": 49.0}
    path = edit(folder, "plan.toml", changes)
    out = tmp_path / "run"
    assert run("optimise", path, "--out", out) == 0
    assert "the plan on the true tissue" in capsys.readouterr().out
    metrics = json.loads((out / "metrics.json").read_text())["value"]
    before = [9e3, 7e3, 9e3, 7e3]
    assert metrics["amplitudes"][:4] == before
    judged = metrics["judged"]
    assert judged["amplitudes"][:4] == before
    assert judged["D90"] > 0.5 * judged["best_D90"]
    assert judged["T_max"] < 49.5


def test_a_phase_is_a_temperature(folder):
    frames = np.load(folder / "temperature.npy")
    radians = -(frames - 37.0) / 39.1443 * 2 * np.pi
    np.save(folder / "phase.npy", radians)
    table = {"readings": "phase.npy", "quantity": "phase", "magnet": 3.0, "echo": 0.02}
    table |= {"noise": 1.0, "every": 60.0, "drift": "none"}
    path = edit(folder, "case.toml", {"learn.thermometry": table}, "phase.toml")
    case, _ = read_case(path)
    setup = Setup.of(case, folder)
    data = read_frames(case.learn.thermometry, setup.body.image, setup.arterial, folder)
    assert data.turn == pytest.approx(39.1443, abs=1e-3)
    expected = np.moveaxis(frames, -1, 0)
    assert np.allclose(data.values, expected, atol=1e-3, equal_nan=True)
    assert data.times[-1] == 720.0


LAW = {"temperatures": [37.0, 45.0], "values": [0.8, 4.0], "unit": "kg/m3/s"}


def plane_of_voxels(folder, kind):
    """A plane whose muscle is perfused more as it warms, and frames of it: the case."""
    shape, sizes = (11, 10), [5e-3, 5e-3]
    labels = np.ones(shape, int)
    labels[4:7, 4:7] = 4
    np.save(folder / "labels.npy", labels)
    squares = (np.indices(shape) - 5.0) ** 2
    np.save(folder / "sar.npy", 150.0 * np.exp(-squares.sum(axis=0) / 12))
    flow = {"value": 1.5, "unit": "kg/m3/s"}
    tissues = {
        "muscle": {"label": 1, "preset": "muscle", "perfusion": flow},
        "tumour": {"label": 4, "preset": "tumour", "perfusion": flow},
    }
    case = {
        "title": "A plane",
        "step": 20.0,
        "grid": {"kind": "voxels", "labels": "labels.npy", "size": sizes},
        "tissues": tissues,
        "target": ["tumour"],
        "heating": {"kind": "sar", "file": "sar.npy", "reference": 1e4},
        "field": {"frequency": 1e5, "times": [0, 300, 600], "amplitudes": [1e4, 5e3]},
    }
    muscle = tissues["muscle"] | {"perfusion": LAW}
    truth = case | {"tissues": tissues | {"muscle": muscle}}
    (folder / "truth.toml").write_text(tomli_w.dumps(truth))
    setup = Setup.read(folder / "truth.toml")
    heated = np.asarray(
        solve(
            setup.model, setup.protocol, stepper=setup.stepper, save_every=60.0
        ).observed
    )
    noise = 0.2 * np.random.default_rng(0).normal(size=heated.shape)
    np.save(folder / "frames.npy", np.moveaxis(heated + noise, 0, -1))
    frames = {"readings": "frames.npy", "noise": 0.2, "every": 60.0}
    learn = {"kind": kind, "laws": ["muscle"], "thermometry": frames}
    case["learn"] = learn | {"truth": "truth.toml"}
    (folder / "case.toml").write_text(tomli_w.dumps(case))
    return folder / "case.toml"


@pytest.mark.slow
def test_a_law_of_temperature_is_learned_from_frames(tmp_path, capsys):
    with jax.numpy_dtype_promotion("standard"):
        path = plane_of_voxels(tmp_path, "kernels")
    out = tmp_path / "run"
    assert run("learn", path, "--out", out) == 0
    assert "coverage of the 95 % band" in capsys.readouterr().out
    metrics = json.loads((out / "metrics.json").read_text())["value"]
    assert metrics["residual"] == pytest.approx(1.0, abs=0.1)
    assert metrics["residual"] < metrics["constant_residual"]
    assert metrics["laws"]["muscle"]["covered"] > 0.9
    law = RunFolder.open(out).load("metrics", LearnedTissue).laws["muscle"]
    at, values, true = law.temperatures, law.values, law.true
    # the truth is that of the case that made the frames, not where the fit started
    assert true == pytest.approx(np.interp(at, LAW["temperatures"], LAW["values"]))
    warm = (at > 40) & (at < 42)
    assert values[warm] == pytest.approx(true[warm], rel=0.2)
    assert (out / "figures" / "heat-perfusion.svg").exists()
