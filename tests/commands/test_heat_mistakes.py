"""Mistakes with images, frames, protocols and plans: refused before anything is done.

They were written after the checks, with none of these in view; what they brought to
light was mended.
"""

import io

import numpy as np
import pytest
from tests.heat_cases import (
    LABELS,
    PLANE,
    SHAPE,
    ball,
    change,
    refuse,
    voxels,
    write,
)

FRAME = np.full((*SHAPE, 1), 37.5)


def sar(file):
    return {"heating": {"kind": "sar", "file": file, "reference": 1e4}}


def measured(**table):
    table = {"amplitudes": [1e3, 2e4], "frequencies": [1e5]} | table
    table |= {"kind": "measured", "concentration": 5.0}
    return {"heating": table | {"slp": table.get("slp", [[1.0], [4.0]])}}


def field(**table):
    return {"field": {"frequency": 1e5, "times": [0, 1800]} | table}


def bursts(on, **table):
    return field(**({"on": on, "off": on, "amplitudes": [1e4]} | table))


def frames(learn=None, **table):
    table = {"readings": "frames.npy", "noise": 1.0, "every": 60.0} | table
    table = {key: value for key, value in table.items() if value is not None}
    laws = {"kind": "constant", "laws": ["tumour"], "thermometry": table}
    return {"learn": laws | (learn or {})}


def phase(**table):
    return frames(**({"quantity": "phase", "magnet": 3.0, "echo": 0.02} | table))


def plan(**table):
    return {"optimise": {"largest": 2e4} | table}


def nifti(values, affine=None, every=None):
    """Bytes of a file."""
    import nibabel

    affine = np.diag([2.0, 2.0, 4.0, 1.0]) if affine is None else affine
    image = nibabel.Nifti1Image(values, affine)
    image.header.set_xyzt_units("mm", "sec")
    if every is not None:
        image.header["pixdim"][4] = every
    return image.to_bytes()


def arrays(**values):
    """Bytes of a compressed npz file."""
    file = io.BytesIO()
    np.savez_compressed(file, **values)
    return file.getvalue()


def damaged():
    content = bytearray(arrays(temperature=np.random.default_rng(0).normal(37, 1, 999)))
    middle = len(content) // 3
    content[middle : middle + 20] = bytes(20)
    return bytes(content)


HEADER = (
    b"{'descr': '<f8', 'fortran_order': False, 'shape': (100000, 100000, 100000), }"
)
HUGE = b"\x93NUMPY\x01\x00\x76\x00" + HEADER.ljust(117) + b"\n"
START = {"start": {"file": "start.npy"}}
AT = np.full(SHAPE, 37.0)

IMAGES = {
    "several arrays": ({}, {"labels.npy": arrays(a=LABELS)}, "labels.npy: .* several"),
    "more than memory": ({}, {"labels.npy": HUGE}, "labels.npy: cannot be read"),
    "floats as labels": (
        {},
        {"labels.npy": np.where(LABELS == 9, 1e300, LABELS)},
        "labels.npy: .*save integers",
    ),
    "a negative label": (
        {},
        {"labels.npy": np.where(LABELS == 9, -9, LABELS)},
        "got -9 in 35 voxels",
    ),
    "complex labels": ({}, {"labels.npy": LABELS + 0j}, "expected real numbers"),
    "a folder": ({"grid.labels": "."}, {}, "expected a file that ends in"),
    "the other way round": (
        sar("sar.npy"),
        {"sar.npy": np.ones(SHAPE[::-1])},
        r"sar.npy: expected the shape \(7, 6, 5\)",
    ),
    "holes": (
        sar("sar.npy"),
        {"sar.npy": np.where(LABELS == 4, np.nan, 1.0)},
        "sar.npy: .* 12 voxels without one",
    ),
    "no power": (sar("sar.npy"), {"sar.npy": np.zeros(SHAPE)}, "zeros alone"),
    "a target of NaN": (
        {"target": {"file": "target.npy"}},
        {"target.npy": np.where(LABELS == 4, 1, np.nan)},
        "target.npy: expected the share",
    ),
    "a target twice": ({"target": ["tumour"] * 2}, {}, "target: .* each tissue once"),
    "a start in kelvins": (START, {"start.npy": AT + 273.15}, "subtract 273.15"),
    "a start of NaN": (START, {"start.npy": AT * np.nan}, "start.npy: .* nan"),
    "a start of text": (START, {"start.npy": AT.astype(str)}, "expected numbers as"),
    "a start less than none": (
        {"start": {"file": "start.npz"}},
        {"start.npz": arrays(temperature=AT, dose=-AT)},
        "start.npz: expected doses >= 0",
    ),
    "a damaged start": (
        {"start": {"file": "start.npz"}},
        {"start.npz": damaged()},
        "start.npz: cannot be read",
    ),
}
FRAMES = {
    "a rise in kelvins": (frames(quantity="rise"), FRAME + 273.15, "expected a rise"),
    "kelvins with a turn": (
        frames(turn=16.0, drift="none"),
        FRAME + 273.15,
        "frames.npy: .*subtract 273.15 from kelvins",
    ),
    "degrees": (phase(), FRAME * 0 + 170.0, "multiply degrees by pi/180"),
    "an echo in ms": (phase(echo=20.0), FRAME, "thermometry.echo: .*give seconds"),
    "a magnet in gauss": (phase(magnet=3e4), FRAME, "magnet: .*give tesla"),
    "a shift in ppm": (phase(coefficient=-0.01), FRAME, "coefficient: .*about -1e-8"),
    "a noise map of temperatures": (
        frames(noise="noise.npy"),
        {"frames.npy": FRAME, "noise.npy": AT + 273.15},
        "noise.npy: .* <= 100 K",
    ),
    "no noise anywhere": (
        frames(noise="noise.npy"),
        {"frames.npy": FRAME, "noise.npy": AT * np.nan},
        "noise.npy: expected the standard deviation",
    ),
    "lost voxels alone": (frames(), FRAME * np.nan, "expected a reading, got none"),
    "a lost frame": (
        frames(every=20.0),
        np.concatenate([FRAME, FRAME * np.nan, FRAME], axis=-1),
        "a frame without them",
    ),
    "frames first": (frames(), np.moveaxis(FRAME, -1, 0), "frames.npy: expected the"),
    "a table": (frames(readings="frames.csv"), FRAME, "frames.csv: expected a file"),
    "tissue without voxels": (
        frames({"laws": ["fat"]}),
        np.where((LABELS == 9)[..., None], np.nan, FRAME),
        "learn.laws: .* got fat, of which no voxel is read",
    ),
    "a truth of smaller voxels": (
        frames({"truth": "truth.toml"}),
        {
            "frames.npy": FRAME,
            "truth.toml": voxels() | {"grid": voxels()["grid"] | {"size": [1e-3] * 3}},
        },
        "learn.truth: expected a case on the cells",
    ),
    "a truth of other tissues": (
        frames({"truth": "truth.toml"}),
        {
            "frames.npy": FRAME,
            "other.npy": np.where(LABELS == 4, 1, LABELS),
            "truth.toml": voxels()
            | {"grid": voxels()["grid"] | {"labels": "other.npy"}, "target": ["fat"]}
            | {
                "tissues": {k: v for k, v in voxels()["tissues"].items() if k[0] != "t"}
            },
        },
        "learn.truth: expected a case with the tissue tumour",
    ),
}
BALLS = {
    "frames of a sphere": ("learn", frames(), "expected a grid of voxels"),
    "a spot of a sphere": (
        "learn",
        {"learn": {"spot": True, "kind": "constant"}},
        "learn.spot: expected a box or voxels",
    ),
    "bursts with a switch": (
        "simulate",
        bursts(50.0, times=[0, 600, 1800]),
        "field.times: expected 0 and the end of the bursts",
    ),
    "a burst for ever": ("simulate", bursts(5e4), "field.on: .* < 1800 s"),
    "a ramp that jumps": (
        "simulate",
        field(times=[0, 600, 600, 1800], ramp=[0, 1e4, 0, 1e4]),
        "field.times: expected increasing",
    ),
    "a ramp in bursts": (
        "simulate",
        field(ramp=[0, 1e4], on=50.0, off=50.0),
        "field.ramp: expected no amplitudes and no bursts",
    ),
    "no duration": ("simulate", {"field.times": [0, 0]}, "field.times"),
    "negative SLP": (
        "simulate",
        measured(slp=[[10.0], [-5.0]]),
        r"heating.slp\[1\]\[0\]: .*>= 0",
    ),
    "a field beyond the table": (
        "simulate",
        measured(amplitudes=[1e3, 2e3]),
        "heating.amplitudes: expected up to that of the field, 10000 A/m",
    ),
    "a plan beyond the table": (
        "optimise",
        measured() | plan(largest=3e4),
        "heating.amplitudes: expected up to that of the field, 30000 A/m",
    ),
    "a frequency beside the table": (
        "simulate",
        measured(frequencies=[1e6]),
        "field.frequency: expected within heating.frequencies",
    ),
    "a spot beside the tissue": (
        "simulate",
        PLANE | {"heating.width": 0.01, "heating.center": [0.5, 0.5]},
        "heating.center: expected between 0 and 0.048 m",
    ),
    "a spot along one axis": (
        "simulate",
        PLANE | {"heating.width": 0.01, "heating.center": [0.02]},
        "heating.center: expected 2 coordinates",
    ),
    "a spot elsewhere in a sphere": (
        "simulate",
        {"heating.width": 0.01, "heating.center": [0.02]},
        "heating.center: expected none on a sphere",
    ),
    "an axis in mm": (
        "simulate",
        PLANE | {"eddy": {"conductivity": 0.4, "axis": [25.0, 25.0]}},
        r"eddy.axis\[0\]: .*give metres",
    ),
    "one long step": ("simulate", {"step": 5e3}, "step: expected within the protocol"),
    "a bound below the wall": (
        "optimise",
        plan(max_temperature=43.0) | {"wall.temperature": 45.0},
        "optimise.max_temperature: expected above that of the walls, 45 °C",
    ),
    "a margin in mm": (
        "optimise",
        plan(healthy_dose=5.0, margin=3.0),
        "optimise.margin: expected tissue further than it",
    ),
    "bursts of nothing": (
        "optimise",
        plan() | bursts(50.0, amplitudes=[0.0]),
        "field.amplitudes: expected one > 0",
    ),
    "a field that heats nothing": (
        "optimise",
        plan() | {"heating.density": 0.0},
        "heating: expected a power > 0 W",
    ),
}


def of_voxels(folder, changes, files):
    """The file of a case of voxels, steps of 20 s."""
    content = change(voxels() | {"step": 20.0}, changes)
    return write(folder, content, {"labels.npy": LABELS} | files)


@pytest.mark.parametrize(("changes", "files", "message"), IMAGES.values(), ids=IMAGES)
def test_images(tmp_path, capsys, changes, files, message):
    refuse(capsys, "simulate", of_voxels(tmp_path, changes, files), message)


@pytest.mark.parametrize(("changes", "given", "message"), FRAMES.values(), ids=FRAMES)
def test_frames(tmp_path, capsys, changes, given, message):
    files = given if isinstance(given, dict) else {"frames.npy": given}
    refuse(capsys, "learn", of_voxels(tmp_path, changes, files), message)


@pytest.mark.parametrize(("task", "changes", "message"), BALLS.values(), ids=BALLS)
def test_balls_and_boxes(tmp_path, capsys, task, changes, message):
    refuse(capsys, task, write(tmp_path, change(ball(), changes)), message)


def test_a_plan_that_starts_too_hot(tmp_path, capsys):
    changes = plan(max_temperature=45.0) | START
    case = of_voxels(tmp_path, changes, {"start.npy": AT + 10.0})
    message = "optimise.max_temperature: expected above the temperature at the start"
    refuse(capsys, "optimise", case, message)


# NIfTI


@pytest.mark.extras("nibabel")
@pytest.mark.parametrize("name", ["damaged", "mirrored", "hyper", "times", "turned"])
def test_nifti(tmp_path, capsys, name):
    mirror = np.diag([-2.0, 2.0, 4.0, 1.0])
    turn = mirror[[1, 0, 2, 3]]
    both = np.concatenate([FRAME, FRAME], axis=-1)
    files = {"labels.nii": nifti(LABELS)}
    given = frames(readings="frames.nii", every=None)
    task, changes, more, message = {
        "damaged": ("simulate", {}, {"labels.nii": nifti(LABELS)[:120]}, "cannot be"),
        "mirrored": (
            "simulate",
            sar("sar.nii"),
            {"sar.nii": nifti(np.ones(SHAPE), mirror)},
            "sar.nii: expected the affine of labels.nii",
        ),
        "hyper": (
            "simulate",
            {},
            {"labels.nii": nifti(np.ones((7, 6, 5, 2, 2)))},
            "labels.nii: expected voxels along three axes",
        ),
        "times": (
            "learn",
            frames(readings="frames.nii", every=6.0),
            {"frames.nii": nifti(both, every=20.0)},
            "thermometry.every: expected 20 s, that of frames.nii, got 6 s",
        ),
        "turned": (
            "learn",
            given,
            {"frames.nii": nifti(both, turn, every=20.0)},
            "frames.nii: expected the affine of labels.nii",
        ),
    }[name]
    grid = {"grid": {"kind": "voxels", "labels": "labels.nii"}}
    case = of_voxels(tmp_path, grid | changes, files | more)
    refuse(capsys, task, case, message)
