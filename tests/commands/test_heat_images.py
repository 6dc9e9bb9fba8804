"""`pinav heat`: what does not go together, and images, frames and plans at fault.

Many of them were written after the checks, with none of these in view.
"""

import io
import sys

import numpy as np
import pytest
from tests.heat_cases import FLOW as PERFUSED
from tests.heat_cases import (
    GONE,
    LABELS,
    NUMBERS,
    PLANE,
    SHAPE,
    ball,
    change,
    refuse,
    voxels,
    write,
)

NAN, INF = float("nan"), float("inf")


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


def spot(**table):
    return PLANE | {f"heating.{name}": value for name, value in table.items()}


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


SPOT = {"learn": {"spot": True, "kind": "constant"}}
JUMP = field(times=[0, 600, 600, 1800], ramp=[0, 1e4, 0, 1e4])
TOO_COLD = plan(max_temperature=43.0) | {"wall.temperature": 45.0}
EDDY = PLANE | {"eddy": {"conductivity": 0.4, "axis": [25.0, 25.0]}}
PULSES = bursts(50.0, times=[0, 600, 1800])
LEARN = [
    (frames(), "expected a grid of voxels"),
    (SPOT, "learn.spot: expected a box or voxels"),
]
SIMULATE = [
    (PULSES, "field.times: expected 0 and the end of the bursts"),
    (bursts(5e4), "field.on: .* < 1800 s"),
    (JUMP, "field.times: expected increasing"),
    (field(ramp=[0, 1e4], on=50.0, off=50.0), "ramp: expected no amplitudes and no bu"),
    ({"field.times": [0, 0]}, "field.times"),
    (measured(slp=[[10.0], [-5.0]]), r"heating.slp\[1\]\[0\]: .*>= 0"),
    (measured(amplitudes=[1e3, 2e3]), "heating.amp.* up to that of the field, 10000 A"),
    (measured(frequencies=[1e6]), "field.frequency: expected within heating.freq"),
    (spot(width=0.01, center=[0.5, 0.5]), "heating.center: .* between 0 and 0.048 m"),
    (spot(width=0.01, center=[0.02]), "center: expected 2 coordinates"),
    ({"heating.width": 0.01, "heating.center": [0.02]}, "expected none on a sphere"),
    (EDDY, r"eddy.axis\[0\]: .*give metres"),
    ({"step": 5e3}, "step: expected within the protocol"),
    (PLANE | {"step": 900.0}, "RKL2.longest: .* stable on this grid, got 900 s"),
]
OPTIMISE = [
    (measured() | plan(largest=3e4), "heating.amp.* up to that of the field, 30000 A/"),
    (TOO_COLD, "optimise.max_temperature: expected above that of the walls, 45 °C"),
    (plan(healthy_dose=5.0, margin=3.0), "optimise.margin: .* tissue further than it"),
    (plan() | bursts(50.0, amplitudes=[0.0]), "field.amplitudes: expected one > 0"),
    (plan() | {"heating.density": 0.0}, "heating: expected a power > 0 W"),
]
BALLS = [
    *(("learn", *row) for row in LEARN),
    *(("simulate", *row) for row in SIMULATE),
    *(("optimise", *row) for row in OPTIMISE),
]


@pytest.mark.parametrize(("task", "changes", "message"), BALLS)
def test_what_does_not_go_together(tmp_path, capsys, task, changes, message):
    refuse(capsys, task, write(tmp_path, change(ball(), changes)), message)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            {"tissues": {"fat": {"label": 1, "preset": "fat", "perfusion": PERFUSED}}},
            "alone",
        ),
        ({"target": ["tumour"]}, "tissues, target: expected with a grid of voxels"),
        ({"tissue.label": 1}, "tissue.label: expected with a grid of voxels"),
        ({"tissue.density": "rho.npy"}, "got the file 'rho.npy'; maps need a grid"),
    ],
)
def test_boxes_have_no_voxels(tmp_path, capsys, table, message):
    tissue = NUMBERS | {"perfusion": PERFUSED}
    case = voxels() | {
        "grid": {"kind": "box", "cells": [8, 8], "size": [2e-3, 3e-3]},
        "tissue": tissue,
        "tumour": {"radius": 4e-3, "tissue": tissue},
    }
    del case["tissues"], case["target"]
    refuse(capsys, "simulate", write(tmp_path, change(case, table)), message)


HEADER = (
    b"{'descr': '<f8', 'fortran_order': False, 'shape': (100000, 100000, 100000), }"
)
HUGE = b"\x93NUMPY\x01\x00\x76\x00" + HEADER.ljust(117) + b"\n"
AT = np.full(SHAPE, 37.0)
FAR = np.where(LABELS == 9, 1e300, LABELS)
HOLED = np.where(LABELS == 4, 1, NAN)
BONE = {"tissues.bone": NUMBERS | {"label": 2, "perfusion": PERFUSED}}
BARE = {"grid": {"kind": "voxels", "labels": "labels.npy"}}
FILE = {"target": {"file": "m.npy"}}
MAP = {"tissues.muscle.density": "m.npy"}
START, ZIPPED = ({"start": {"file": f"m.np{end}"}} for end in "yz")
DOSED = {"m.npz": arrays(temperature=AT, dose=-AT)}
PLENTY = {"kind": "particles", "concentration": "m.npy", "diameter": 14.0}
VOXELS = [
    ({}, np.where(LABELS == 9, 7, LABELS), "got 7 in 35 voxels; add a table"),
    ({"tissues.fat.label": 8}, {}, "labels of tissues, 1, 8, 4; got 9 in 35"),
    (BONE, {}, "bone: .* got 2"),
    ({"tissues.fat.label": 4}, {}, "a different label for each"),
    ({"tissues": {}}, {}, "got no tissues"),
    ({"target": []}, {}, "got no target"),
    ({"target": ["bone"]}, {}, "target: expected names of tissues, .* 'bone'"),
    ({"target": ["tumour"] * 2}, {}, "target: .* each tissue once"),
    (FILE, {"m.npy": np.full(SHAPE, 2.0)}, "share of the target"),
    (FILE, {"m.npy": HOLED}, "m.npy: expected the share"),
    (FILE, {"m.npy": np.full(SHAPE, 0.1)}, "expected a target"),
    (FILE, {"m.npy": np.ones((7, 6))}, "expected the shape"),
    ({"tissue": {"preset": "fat", "perfusion": PERFUSED}}, {}, "expected none on a gr"),
    ({"grid.labels": "no.npy"}, {}, "no.npy: cannot be read"),
    ({"grid.labels": "."}, {}, "expected a file that ends in"),
    ({}, arrays(a=LABELS), "labels.npy: .* several"),
    ({}, HUGE, "labels.npy: cannot be read"),
    ({}, FAR, "labels.npy: .*save integers"),
    ({}, LABELS + 0.5, "expected labels, whole numbers"),
    ({}, LABELS * NAN, "expected labels, whole numbers"),
    ({}, LABELS.astype(str), "expected real numbers"),
    ({}, LABELS + 0j, "expected real numbers"),
    ({}, LABELS[:, :, :2], "three voxels or more, got shape"),
    ({}, LABELS[0, 0], "two or three axes"),
    (BARE, {}, "give grid.size in met"),
    ({"grid.size": [2.0, 2.0, 4.0]}, {}, "grid.size.* <= 0.05, got 2.0; give metres"),
    ({"grid.size": [2e-3, 2e-3]}, {}, "grid.size: expected 3 numbers"),
    ({"grid.size": [2e-3, 0.0, 2e-3]}, {}, "grid.size.* got 0.0; give met"),
    ({"sides.z": "open"}, {}, "sides.z"),
    ({"probes.points": [[0.1, 0.1, 0.1]]}, {}, "probes.points"),
    ({"heating.edge_weighted": True}, {}, "expected none on a grid of voxels"),
    (plan(placement=3), {}, "expected none on a grid of"),
    (MAP, {"m.npy": np.ones(SHAPE)}, "m.npy: .* >= 50"),
    (MAP, {"m.npy": np.ones(SHAPE[::-1])}, r"m.npy: expected the shape \(7, 6, 5\)"),
    (MAP, {"m.npy": np.full((*SHAPE, 4), 1e3)}, "got frames"),
    ({"tissues.fat.density": "m.npy"}, {"m.npy": AT * NAN}, "35 voxels without"),
    (
        {"tissues.fat.perfusion": {"file": "m.npy", "unit": "1/s"}},
        {"m.npy": np.ones(SHAPE)},
        "check the unit",
    ),
    ({"tissues.fat.perfusion": {"file": "m.npy"}}, {}, "expected a law, or a value"),
    (sar("m.npy"), {"m.npy": np.full(SHAPE, -1.0)}, "m.npy: .*give W/kg"),
    (sar("m.npy"), {"m.npy": HOLED}, "m.npy: .* 198 voxels without one"),
    (sar("m.npy"), {"m.npy": np.zeros(SHAPE)}, "zeros alone"),
    ({"heating": PLENTY}, {"m.npy": np.full(SHAPE, 1e4)}, "give mg/cm³"),
    (START, {"m.npy": np.full((3, 3), 37.0)}, "of shape"),
    (START, {"m.npy": AT + 273.15}, "subtract 273.15"),
    (START, {"m.npy": AT * NAN}, "m.npy: .* nan"),
    (START, {"m.npy": AT.astype(str)}, "expected numbers as"),
    (ZIPPED, DOSED, "m.npz: expected doses >= 0"),
    (ZIPPED, {"m.npz": damaged()}, "m.npz: cannot be read"),
]
FRAME = np.full((*SHAPE, 1), 37.5)
LATE = np.concatenate([FRAME, FRAME * NAN, FRAME], axis=-1)
GRID = voxels()["grid"]
FINE = {"truth.toml": voxels() | {"grid": GRID | {"size": [1e-3] * 3}}}
OTHER = {
    "other.npy": np.where(LABELS == 4, 1, LABELS),
    "truth.toml": voxels()
    | {"grid": GRID | {"labels": "other.npy"}, "target": ["fat"]}
    | {"tissues": {k: v for k, v in voxels()["tissues"].items() if k != "tumour"}},
}
TRUTH = frames({"truth": "truth.toml"})
AFTER = frames() | plan(after=30.0)
FRAMES = [
    (frames(readings="no.npy"), FRAME, "no.npy: cannot be read"),
    (frames(readings="labels.npy"), FRAME, "frames along a last axis"),
    (frames(readings="frames.csv"), FRAME, "frames.csv: expected a file"),
    (frames(), FRAME[:, :, 0], "expected the shape"),
    (frames(), np.moveaxis(FRAME, -1, 0), "frames.npy: expected the"),
    (frames(), FRAME * INF, "or NaN where a voxel is"),
    (frames(), FRAME * NAN, "expected a reading, got none"),
    (frames(every=20.0), LATE, "a frame without them"),
    (frames(every=None), FRAME, "a time between frames with a unit"),
    (frames(every=6e3), FRAME, "saved time .* up to 60 s"),
    (frames(noise=0.0), FRAME, "noise: expected a number > 0"),
    (frames(noise="m.npy"), {"m.npy": AT + 273.15}, "m.npy: .* <= 100 K"),
    (frames(noise="m.npy"), {"m.npy": AT * NAN}, "m.npy: expected the standard devi"),
    (frames(noise="m.npy"), {"m.npy": AT * 0}, "m.npy: expected the standard devi"),
    (frames(turn=-1.0), FRAME, "turn: expected a number > 0"),
    (frames(drift="cubic"), FRAME, "drift"),
    (frames(quantity="rise"), FRAME + 273.15, "expected a rise"),
    (frames(turn=16.0), FRAME + 273.15, "frames.npy: .*subtract 273.15 from kelvins"),
    (frames(quantity="phase"), FRAME, "magnet and echo with a phase"),
    (frames(magnet=3.0), FRAME, "magnet and echo with a phase"),
    (phase(turn=16.0), FRAME, "turn: expected none with a phase"),
    (phase(), FRAME * 0 + 170.0, "multiply degrees by pi/180"),
    (phase(echo=20.0), FRAME, "thermometry.echo: .*give seconds"),
    (phase(magnet=3e4), FRAME, "magnet: .*give tesla"),
    (phase(coefficient=-0.01), FRAME, "coefficient: .*about -1e-8"),
    (frames({"data": "a.csv"}), FRAME, "expected data or thermometry, got both"),
    (frames({"held_out": [1.3]}), FRAME, "held_out: expected none with data"),
    (frames({"until": 30.0}), FRAME, "a time after the first reading at 60 s"),
    (frames({"laws": ["bone"]}), FRAME, "learn.laws: expected names of tissues"),
    (
        frames({"laws": ["fat"]}),
        np.where((LABELS == 9)[..., None], NAN, FRAME),
        "learn.laws: .* got fat, of which no voxel is read",
    ),
    (frames({"truth": "no.toml"}), FRAME, "no.toml: cannot be read"),
    (TRUTH, FINE, "learn.truth: expected a case on the cells"),
    (TRUTH, OTHER, "learn.truth: expected a case with the tissue tumour"),
    (
        change(frames({"truth": "truth.toml"}), {"learn.thermometry": GONE}),
        {},
        "truth, until: expected with data",
    ),
]
SYNTHETIC = {"learn": {"kind": "constant", "laws": ["tumour"]}}
TWICE = {"field.times": [0, 30, 60], "field.amplitudes": [1e4, 1e4]}
PLANS = [
    (AFTER, FRAME, "a time at which constant amplitudes"),
    (SYNTHETIC | plan(after=30.0) | TWICE, {}, "from which a plan"),
    (frames({"laws": []}) | plan(after=60.0), FRAME, "expected something to learn"),
    (
        plan(max_temperature=45.0) | START,
        {"m.npy": AT + 10.0},
        "optimise.max_temperature: expected above the temperature at the start",
    ),
]
OF_VOXELS = [
    *(("simulate", "labels.npy", *row) for row in VOXELS),
    *(("learn", "frames.npy", *row) for row in FRAMES),
    *(("optimise", "frames.npy", *row) for row in PLANS),
]


def of_voxels(folder, changes, files):
    """The file of a case of voxels, steps of 20 s."""
    content = change(voxels() | {"step": 20.0}, changes)
    return write(folder, content, {"labels.npy": LABELS, "frames.npy": FRAME} | files)


@pytest.mark.parametrize(("task", "name", "changes", "given", "message"), OF_VOXELS)
def test_images_that_are_none(tmp_path, capsys, task, name, changes, given, message):
    """Arrays and bytes stand for the labels, or the frames; others have their names."""
    files = given if isinstance(given, dict) else {name: given}
    refuse(capsys, task, of_voxels(tmp_path, changes, files), message)


def test_nifti_asks_for_its_package(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "nibabel", None)
    case = of_voxels(tmp_path, {"grid.labels": "labels.nii.gz"}, {})
    refuse(capsys, "simulate", case, r"pip install 'pinav\[mri\]'")


@pytest.mark.extras("nibabel")
@pytest.mark.parametrize("name", ["damaged", "mirrored", "hyper", "times", "turned"])
def test_images_of_nifti_that_are_none(tmp_path, capsys, name):
    def nifti(values, affine=None, every=None):
        import nibabel

        affine = np.diag([2.0, 2.0, 4.0, 1.0]) if affine is None else affine
        image = nibabel.Nifti1Image(values, affine)
        image.header.set_xyzt_units("mm", "sec")
        if every is not None:
            image.header["pixdim"][4] = every
        return image.to_bytes()

    mirror = np.diag([-2.0, 2.0, 4.0, 1.0])
    turn = mirror[[1, 0, 2, 3]]
    both = np.concatenate([FRAME, FRAME], axis=-1)
    labels = nifti(LABELS)
    task, changes, file, content, message = {
        "damaged": ("simulate", {}, "labels", labels[:120], "cannot be"),
        "mirrored": (
            "simulate",
            sar("sar.nii"),
            "sar",
            nifti(np.ones(SHAPE), mirror),
            "sar.nii: expected the affine of labels.nii",
        ),
        "hyper": (
            "simulate",
            {},
            "labels",
            nifti(np.ones((7, 6, 5, 2, 2))),
            "labels.nii: expected voxels along three axes",
        ),
        "times": (
            "learn",
            frames(readings="frames.nii", every=6.0),
            "frames",
            nifti(both, every=20.0),
            "thermometry.every: expected 20 s, that of frames.nii, got 6 s",
        ),
        "turned": (
            "learn",
            frames(readings="frames.nii", every=None),
            "frames",
            nifti(both, turn, every=20.0),
            "frames.nii: expected the affine of labels.nii",
        ),
    }[name]
    grid = {"grid": {"kind": "voxels", "labels": "labels.nii"}}
    files = {"labels.nii": labels, f"{file}.nii": content}
    refuse(capsys, task, of_voxels(tmp_path, grid | changes, files), message)
