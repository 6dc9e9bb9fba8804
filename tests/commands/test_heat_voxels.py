"""`pinav heat` on images of voxels: what is read, what is refused, what is written."""

import json
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tomli_w

from pinav import cli
from pinav.thermal.images import read_image
from pinav.thermal.planned_run import tissue_beyond
from pinav.thermal.setup import Setup

SHAPE, SIZE = (7, 6, 5), (2e-3, 2e-3, 4e-3)
FLOW = {"value": 1.0, "unit": "kg/m3/s"}
NUMBERS = {"conductivity": 0.5, "density": 1000.0, "specific_heat": 3500.0}


def labels():
    """A block of 4 within 1, a layer of 9."""
    values = np.ones(SHAPE, np.int16)
    values[2:5, 2:4, 1:3], values[:, 0] = 4, 9
    return values


def content(**changes):
    return {
        "title": "Voxels",
        "grid": {"kind": "voxels", "labels": "labels.npy", "size": list(SIZE)},
        "tissues": {
            "muscle": NUMBERS | {"label": 1, "perfusion": FLOW},
            "fat": {"label": 9, "preset": "fat", "perfusion": {"law": "fat"}},
            "tumour": NUMBERS | {"label": 4, "perfusion": FLOW, "conductivity": 0.6},
        },
        "target": ["tumour"],
        "heating": {"kind": "power", "density": 2e5, "reference": 1e4},
        "field": {"frequency": 1e5, "times": [0, 60], "amplitudes": [1e4]},
    } | changes


def change(case, path, value):
    *tables, last = path.split(".")
    for table in tables:
        case = case.setdefault(table, {})
    case[last] = value


def write(folder, changes=None, **arrays):
    """A case and its maps; its file."""
    case = content()
    for path, value in (changes or {}).items():
        change(case, path, value)
    for name, values in ({"labels": labels()} | arrays).items():
        np.save(folder / f"{name}.npy", values)
    (folder / "case.toml").write_text(tomli_w.dumps(case))
    return folder / "case.toml"


def run(*argv):
    with jax.numpy_dtype_promotion("standard"):
        return cli.run(["heat", *map(str, argv)])


def test_tissues_and_maps_are_where_the_labels_are(tmp_path):
    conductivity = np.where(labels() == 1, 0.4, np.nan)
    conductivity[0, 3, 0] = 0.45
    perfusion = np.linspace(0.1, 2.0, labels().size).reshape(SHAPE)
    path = write(
        tmp_path,
        {
            "tissues.muscle.conductivity": "k.npy",
            "tissues.tumour.perfusion": {"file": "w.npy", "unit": "kg/m3/s"},
            "heating": {"kind": "sar", "file": "sar.npy", "reference": 1e4},
        },
        k=conductivity,
        w=perfusion,
        sar=np.full(SHAPE, 50.0),
    )
    setup = Setup.read(path)
    model, tumour = setup.model, labels() == 4
    k = np.asarray(model.tissue.conductivity)
    assert k[0, 3, 0] == 0.45
    assert np.all(k[tumour] == 0.6)
    assert np.all(k[labels() == 9] == 0.21)
    w = np.asarray(model.perfusion(jnp.full(SHAPE, 50.0)))
    assert w[tumour] == pytest.approx(perfusion[tumour])
    assert w[labels() == 9] == pytest.approx(0.72)
    source = np.asarray(model.sources[0].shape(model.grid))
    assert source[0, 0, 0] == pytest.approx(50.0 * 911.0)
    assert np.array_equal(np.asarray(setup.body.target) > 0, tumour)
    assert [float(size) for size in model.grid.spacing] == list(SIZE)
    assert setup.body.middle == pytest.approx((0.007, 0.006, 0.008))


def test_perfusion_maps_take_every_unit(tmp_path):
    density = np.where(labels() == 4, np.linspace(900, 1100, 210).reshape(SHAPE), 1e9)
    flow = {"file": "w.npy", "unit": "ml/min/kg"}
    changes = {"tissues.tumour.perfusion": flow, "tissues.tumour.density": "rho.npy"}
    path = write(tmp_path, changes, w=np.full(SHAPE, 30.0), rho=density)
    model = Setup.read(path).model
    w = np.asarray(model.perfusion(jnp.full(SHAPE, 37.0)))[labels() == 4]
    assert w == pytest.approx(30e-6 / 60 * 1050 * density[labels() == 4])


def test_a_margin_is_a_distance_from_the_target(tmp_path):
    path = write(tmp_path)
    away = np.asarray(tissue_beyond(Setup.read(path), 0.0025))
    assert not away[labels() == 4].any()
    assert not away[1, 2, 1]  # a voxel of 2 mm beside the target
    assert away[0, 2, 1]  # the next: it begins 2 mm, its middle is 3 mm from it
    assert away[3, 3, 3] == 1  # a voxel of 4 mm beside it


def test_a_target_of_any_shape_from_a_file(tmp_path):
    share = np.zeros(SHAPE)
    share[1, 1, 1], share[1, 2, 1] = 1.0, 0.25
    path = write(tmp_path, {"target": {"file": "share.npy"}}, share=share)
    setup = Setup.read(path)
    assert float(jnp.sum(setup.body.target)) == 1.25
    assert list(setup.body.laws) == ["muscle", "fat", "tumour"]


@pytest.mark.slow
def test_a_plane_of_voxels_runs(tmp_path, capsys):
    plane = labels()[:, :, 1]
    path = write(tmp_path, {"grid.size": [2e-3, 2e-3], "step": 20.0}, labels=plane)
    assert run("simulate", path, "--out", tmp_path / "run", "--json") == 0
    metrics = json.loads(capsys.readouterr().out)
    assert metrics["T90"] > 38.0
    assert metrics["imbalance"] < 1e-10
    assert not list((tmp_path / "run").glob("*.nii.gz"))


NAN = float("nan")
UNKNOWN = np.where(labels() == 9, 7, labels())
REFUSED = [
    ({}, {"labels": UNKNOWN}, r"labels.npy: .* got 7 in 35 voxels; add a table"),
    ({"tissues.fat.label": 8}, {}, "labels of tissues, 1, 8, 4; got 9 in 35"),
    ({"tissues.bone": NUMBERS | {"label": 2, "perfusion": FLOW}}, {}, "bone: .* got 2"),
    ({"tissues.fat.label": 4}, {}, "a different label for each"),
    ({"tissues": {}}, {}, "got no tissues"),
    ({"target": []}, {}, "got no target"),
    ({"target": ["bone"]}, {}, "target: expected names of tissues, .* 'bone'"),
    ({"target": {"file": "s.npy"}}, {"s": np.full(SHAPE, 2.0)}, "share of the target"),
    ({"target": {"file": "s.npy"}}, {"s": np.full(SHAPE, 0.1)}, "expected a target"),
    ({"target": {"file": "s.npy"}}, {"s": np.ones((7, 6))}, "expected the shape"),
    ({"tissue": {"preset": "fat", "perfusion": FLOW}}, {}, "expected none on a grid"),
    ({"grid.labels": "no.npy"}, {}, "no.npy: cannot be read"),
    ({"grid.labels": "labels.mat"}, {}, "labels.mat: expected a file that ends in"),
    ({}, {"labels": labels() + 0.5}, "expected labels, whole numbers"),
    ({}, {"labels": labels() * np.nan}, "expected labels, whole numbers"),
    ({}, {"labels": labels().astype(str)}, "expected real numbers"),
    ({}, {"labels": labels()[:, :, :2]}, "three voxels or more, got shape"),
    ({}, {"labels": labels()[0, 0]}, "two or three axes"),
    ({"grid": {"kind": "voxels", "labels": "labels.npy"}}, {}, "give grid.size in met"),
    ({"grid.size": [2.0, 2.0, 4.0]}, {}, "grid.size.* <= 0.05, got 2.0; give metres"),
    ({"grid.size": [2e-3, 2e-3]}, {}, "grid.size: expected 3 numbers"),
    ({"grid.size": [2e-3, 0.0, 2e-3]}, {}, "grid.size.* got 0.0; give met"),
    ({"sides.z": "open"}, {}, "sides.z"),
    ({"probes.points": [[0.1, 0.1, 0.1]]}, {}, "probes.points"),
    ({"heating.edge_weighted": True}, {}, "expected none on a grid of voxels"),
    ({"optimise": {"largest": 2e4, "placement": 3}}, {}, "expected none on a grid of"),
    ({"tissues.muscle.density": "m.npy"}, {"m": np.ones(SHAPE)}, "m.npy: .* >= 50"),
    ({"tissues.muscle.density": "m.npy"}, {"m": np.ones((3, 3, 3))}, "the shape"),
    (
        {"tissues.muscle.density": "m.npy"},
        {"m": np.full((*SHAPE, 4), 1e3)},
        "got frames",
    ),
    ({"tissues.fat.density": "m.npy"}, {"m": np.full(SHAPE, NAN)}, "35 voxels without"),
    (
        {"tissues.fat.perfusion": {"file": "m.npy", "unit": "1/s"}},
        {"m": np.ones(SHAPE)},
        "check the unit",
    ),
    ({"tissues.fat.perfusion": {"file": "m.npy"}}, {}, "expected a law, or a value"),
    (
        {"heating": {"kind": "sar", "file": "m.npy", "reference": 1e4}},
        {"m": np.full(SHAPE, -1.0)},
        "m.npy: .*give W/kg",
    ),
    (
        {"heating": {"kind": "particles", "concentration": "m.npy", "diameter": 14.0}},
        {"m": np.full(SHAPE, 1e4)},
        "give mg/cm³",
    ),
    ({"start": {"file": "m.npy"}}, {"m": np.full((3, 3), 37.0)}, "of shape"),
]


@pytest.mark.parametrize(("changes", "arrays", "message"), REFUSED)
def test_bad_voxels(tmp_path, capsys, changes, arrays, message):
    path = write(tmp_path, changes, **arrays)
    assert run("simulate", path, "--out", tmp_path / "run") == cli.USAGE_ERROR
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert re.search(message, line), line
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            {"tissues": {"fat": {"label": 1, "preset": "fat", "perfusion": FLOW}}},
            "alone",
        ),
        ({"target": ["tumour"]}, "tissues, target: expected with a grid of voxels"),
        ({"tissue.label": 1}, "tissue.label: expected with a grid of voxels"),
        ({"tissue.density": "rho.npy"}, "got the file 'rho.npy'; maps need a grid"),
    ],
)
def test_balls_have_no_voxels(tmp_path, capsys, table, message):
    case = content(
        grid={"kind": "box", "cells": [8, 8], "size": [2e-3, 3e-3]},
        tissue=NUMBERS | {"perfusion": FLOW},
        tumour={"radius": 4e-3, "tissue": NUMBERS | {"perfusion": FLOW}},
    )
    del case["tissues"], case["target"]
    for key, value in table.items():
        change(case, key, value)
    (tmp_path / "case.toml").write_text(tomli_w.dumps(case))
    out = tmp_path / "run"
    assert run("simulate", tmp_path / "case.toml", "--out", out) == cli.USAGE_ERROR
    assert re.search(message, capsys.readouterr().err)


def test_nifti_asks_for_its_package(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "nibabel", None)
    path = write(tmp_path, {"grid": {"kind": "voxels", "labels": "labels.nii.gz"}})
    assert run("simulate", path, "--out", tmp_path / "run") == cli.USAGE_ERROR
    assert "pip install 'pinav[mri]'" in capsys.readouterr().err


# NIfTI itself


def save_nifti(path, values, affine=None, unit="mm", **zooms):
    import nibabel

    affine = np.diag([2.0, 2.0, 4.0, 1.0]) if affine is None else affine
    image = nibabel.Nifti1Image(values, affine)
    image.header.set_xyzt_units(unit, "sec")
    for index, zoom in zooms.items():
        image.header["pixdim"][int(index[1:])] = zoom
    image.to_filename(path)


def write_nifti(folder: Path, changes=None, **options):
    save_nifti(folder / "labels.nii.gz", labels(), **options)
    grid = {"kind": "voxels", "labels": "labels.nii.gz"}
    return write(folder, {"grid": grid} | (changes or {}))


@pytest.mark.extras("nibabel")
def test_results_are_where_the_labels_are(tmp_path, capsys):
    turned = np.array([[0, -2, 0, 5], [2, 0, 0, -3], [0, 0, 4, 1], [0, 0, 0, 1.0]])
    path = write_nifti(tmp_path, {"step": 20.0}, affine=turned)
    assert run("simulate", path, "--out", tmp_path / "run") == 0
    written = read_image(tmp_path / "run" / "temperature.nii.gz")
    given = read_image(tmp_path / "labels.nii.gz")
    assert given.spacing == pytest.approx(SIZE)
    assert written.affine == pytest.approx(given.affine)
    with np.load(tmp_path / "run" / "results.npz") as arrays:
        assert written.values == pytest.approx(arrays["temperature"], abs=1e-4)
    assert written.values[3, 3, 1] > 38.0
    assert (tmp_path / "run" / "dose.nii.gz").exists()


@pytest.mark.extras("nibabel")
@pytest.mark.parametrize("unit", ["mm", "meter", "micron"])
def test_units_of_length_are_read(tmp_path, unit):
    factor = {"mm": 1.0, "meter": 1e-3, "micron": 1e3}[unit]
    affine = np.diag([2.0, 2.0, 4.0, 1 / factor]) * factor
    save_nifti(tmp_path / "a.nii.gz", labels(), affine, unit)
    assert read_image(tmp_path / "a.nii.gz").spacing == pytest.approx(SIZE, rel=1e-5)


@pytest.mark.extras("nibabel")
@pytest.mark.parametrize(
    ("options", "changes", "message"),
    [
        ({"unit": "meter"}, {}, r"got 2000 x 2000 x 4000 mm; its unit .* meter"),
        ({"unit": "micron"}, {}, "its unit of length, micron, may be wrong"),
        ({"unit": "unknown"}, {}, "give grid.size in metres"),
        ({}, {"grid.size": [2e-3, 2e-3, 2e-3]}, "grid.size: expected that of labels"),
        ({"z1": 3.0}, {}, "as large as in the header"),
        (
            {"affine": np.eye(4) + np.eye(4, k=1)},
            {},
            "perpendicular axes|in the header",
        ),
    ],
)
def test_bad_places(tmp_path, capsys, options, changes, message):
    path = write_nifti(tmp_path, changes, **options)
    assert run("simulate", path, "--out", tmp_path / "run") == cli.USAGE_ERROR
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert re.search(message, line), line
    assert not (tmp_path / "run").exists()


@pytest.mark.extras("nibabel")
def test_maps_are_where_the_labels_are(tmp_path, capsys):
    path = write_nifti(tmp_path, {"tissues.muscle.density": "rho.nii.gz"})
    moved = np.diag([2.0, 2.0, 4.0, 1.0])
    moved[0, 3] = 4.0
    save_nifti(tmp_path / "rho.nii.gz", np.full(SHAPE, 1e3), moved)
    assert run("simulate", path, "--out", tmp_path / "run") == cli.USAGE_ERROR
    assert "expected the affine of labels.nii.gz" in capsys.readouterr().err
    (tmp_path / "rho.nii.gz").write_bytes(b"nothing")
    assert run("simulate", path, "--out", tmp_path / "run") == cli.USAGE_ERROR
    assert "rho.nii.gz: cannot be read" in capsys.readouterr().err
