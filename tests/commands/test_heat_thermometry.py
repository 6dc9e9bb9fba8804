"""`pinav heat learn`, `optimise` on frames of MR thermometry: the phantom, small."""

import importlib.util
import json
import tomllib

import jax
import numpy as np
import pytest
from tests.heat_cases import EXAMPLES, change, run, write

from pinav.thermal.case import read_case
from pinav.thermal.images import read_frames, read_image
from pinav.thermal.setup import Setup

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
