"""`pinav heat` on images of voxels: what is read, what is refused, what is written."""

import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from tests.heat_cases import LABELS, SHAPE, SIZE, change, refuse, run, voxels
from tests.heat_cases import write as write_case

from pinav.thermal.images import read_image
from pinav.thermal.planned_run import tissue_beyond
from pinav.thermal.setup import Setup


def write(folder, changes=None, **arrays):
    """A case on `LABELS` and its maps; its file."""
    files = {f"{name}.npy": one for name, one in ({"labels": LABELS} | arrays).items()}
    return write_case(folder, change(voxels(), changes or {}), files)


def test_tissues_and_maps_are_where_the_labels_are(tmp_path):
    conductivity = np.where(LABELS == 1, 0.4, np.nan)
    conductivity[0, 3, 0] = 0.45
    perfusion = np.linspace(0.1, 2.0, LABELS.size).reshape(SHAPE)
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
    model, tumour = setup.model, LABELS == 4
    k = np.asarray(model.tissue.conductivity)
    assert k[0, 3, 0] == pytest.approx(0.45, rel=1e-12)
    assert k[tumour] == pytest.approx(0.6, rel=1e-12)
    assert k[LABELS == 9] == pytest.approx(0.21, rel=1e-12)
    w = np.asarray(model.perfusion(jnp.full(SHAPE, 50.0)))
    assert w[tumour] == pytest.approx(perfusion[tumour])
    assert w[LABELS == 9] == pytest.approx(0.72)
    source = np.asarray(model.sources[0].shape(model.grid))
    assert source[0, 0, 0] == pytest.approx(50.0 * 911.0)
    assert np.array_equal(np.asarray(setup.body.target) > 0, tumour)
    assert [float(size) for size in model.grid.spacing] == list(SIZE)
    assert setup.body.middle == pytest.approx((0.007, 0.006, 0.008))


def test_perfusion_maps_take_every_unit(tmp_path):
    density = np.where(LABELS == 4, np.linspace(900, 1100, 210).reshape(SHAPE), 1e9)
    flow = {"file": "w.npy", "unit": "ml/min/kg"}
    changes = {"tissues.tumour.perfusion": flow, "tissues.tumour.density": "rho.npy"}
    path = write(tmp_path, changes, w=np.full(SHAPE, 30.0), rho=density)
    model = Setup.read(path).model
    w = np.asarray(model.perfusion(jnp.full(SHAPE, 37.0)))[LABELS == 4]
    assert w == pytest.approx(30e-6 / 60 * 1050 * density[LABELS == 4])


def test_a_margin_is_a_distance_from_the_target(tmp_path):
    path = write(tmp_path)
    away = np.asarray(tissue_beyond(Setup.read(path), 0.0025))
    assert not away[LABELS == 4].any()
    assert not away[1, 2, 1]  # a voxel of 2 mm beside the target
    assert away[0, 2, 1]  # the next: it begins 2 mm, its middle is 3 mm from it
    assert away[3, 3, 3] == 1  # a voxel of 4 mm beside it


def test_a_target_of_any_shape_from_a_file(tmp_path):
    share = np.zeros(SHAPE)
    share[1, 1, 1], share[1, 2, 1] = 1.0, 0.25
    path = write(tmp_path, {"target": {"file": "share.npy"}}, share=share)
    setup = Setup.read(path)
    assert float(jnp.sum(setup.body.target)) == 1.25
    assert list(setup.body.fractions) == ["muscle", "fat", "tumour"]


@pytest.mark.slow
def test_a_plane_of_voxels_runs(tmp_path, capsys):
    plane = LABELS[:, :, 1]
    path = write(tmp_path, {"grid.size": [2e-3, 2e-3], "step": 20.0}, labels=plane)
    assert run("simulate", path, "--out", tmp_path / "run", "--json") == 0
    metrics = json.loads(capsys.readouterr().out)
    assert metrics["T90"] > 38.0
    assert metrics["imbalance"] < 1e-10
    assert not list((tmp_path / "run").glob("*.nii.gz"))


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
    save_nifti(folder / "labels.nii.gz", LABELS, **options)
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
    save_nifti(tmp_path / "a.nii.gz", LABELS, affine, unit)
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
    refuse(capsys, "simulate", path, message)


@pytest.mark.extras("nibabel")
def test_maps_are_where_the_labels_are(tmp_path, capsys):
    path = write_nifti(tmp_path, {"tissues.muscle.density": "rho.nii.gz"})
    moved = np.diag([2.0, 2.0, 4.0, 1.0])
    moved[0, 3] = 4.0
    save_nifti(tmp_path / "rho.nii.gz", np.full(SHAPE, 1e3), moved)
    refuse(capsys, "simulate", path, "expected the affine of labels.nii.gz")
    (tmp_path / "rho.nii.gz").write_bytes(b"nothing")
    refuse(capsys, "simulate", path, "rho.nii.gz: cannot be read")
