"""Cases of `pinav heat` that tests change, and what refuses them."""

import copy
import re
import tomllib
from pathlib import Path

import jax
import numpy as np
import tomli_w

from pinav import cli

EXAMPLES = Path(__file__).parents[2] / "examples" / "heat"
GONE = "left out"
"""In place of a value: the key is not there."""

SHAPE, SIZE = (7, 6, 5), (2e-3, 2e-3, 4e-3)
FLOW = {"value": 1.0, "unit": "kg/m3/s"}
NUMBERS = {"conductivity": 0.5, "density": 1000.0, "specific_heat": 3500.0}
LABELS = np.ones(SHAPE, np.int16)
LABELS[2:5, 2:4, 1:3], LABELS[:, 0] = 4, 9
"""A block of 4 within 1, a layer of 9."""

PLANE = {
    "grid": {"kind": "box", "cells": [24, 24], "size": 2e-3},
    "probes.points": [[0.02, 0.02]],
}


def ball(name="tumour"):
    """An example on a coarse grid."""
    content = tomllib.loads((EXAMPLES / f"{name}.toml").read_text())
    content["grid"]["cells"] = 24
    return content


def small(name, folder, **changes):
    """An example on a coarse grid, with tables changed: its file."""
    content = ball(name) | {"step": 20.0}
    for table, values in changes.items():
        if isinstance(values, dict):
            content.setdefault(table, {}).update(values)
            content[table] = {k: v for k, v in content[table].items() if v is not None}
        else:
            content[table] = values
    path = folder / f"{name}.toml"
    path.write_text(tomli_w.dumps(content))
    return path


def voxels():
    """A tumour in muscle below fat."""
    return {
        "title": "Voxels",
        "step": 20.0,
        "grid": {"kind": "voxels", "labels": "labels.npy", "size": list(SIZE)},
        "tissues": {
            "muscle": NUMBERS | {"label": 1, "perfusion": FLOW},
            "fat": {"label": 9, "preset": "fat", "perfusion": {"law": "fat"}},
            "tumour": NUMBERS | {"label": 4, "perfusion": FLOW, "conductivity": 0.6},
        },
        "target": ["tumour"],
        "heating": {"kind": "power", "density": 2e5, "reference": 1e4},
        "field": {"frequency": 1e5, "times": [0, 60], "amplitudes": [1e4]},
    }


def frames(learn=None, **table):
    """The table of a fit to frames of thermometry."""
    table = {"readings": "frames.npy", "noise": 1.0, "every": 60.0} | table
    table = {key: value for key, value in table.items() if value is not None}
    laws = {"kind": "constant", "laws": ["tumour"], "thermometry": table}
    return {"learn": laws | (learn or {})}


def change(content, changes):
    """Set, or remove, what stands under dotted keys."""
    for key, value in changes.items():
        *tables, last = key.split(".")
        table = content
        for name in tables:
            table = table.setdefault(name, {})
        if value is GONE:
            table.pop(last, None)
        else:
            table[last] = copy.deepcopy(value)
    return content


def write(folder, content, files=None):
    """The file of a case, with arrays, cases and bytes beside it."""
    for name, values in (files or {}).items():
        if isinstance(values, bytes):
            (folder / name).write_bytes(values)
        elif isinstance(values, dict):
            (folder / name).write_text(tomli_w.dumps(values))
        else:
            np.save(folder / name, values)
    (folder / "case.toml").write_text(tomli_w.dumps(content))
    return folder / "case.toml"


def write_voxels(folder, changes=None, files=None):
    """The file of the case of voxels, changed."""
    content = change(voxels(), changes or {})
    return write(folder, content, {"labels.npy": LABELS} | (files or {}))


def run(*argv):
    with jax.numpy_dtype_promotion("standard"):
        return cli.run(["heat", *map(str, argv)])


def refuse(capsys, message, *argv):
    """A command ends with one line and exit code 2, and writes nothing."""
    folder = Path(argv[1]).parent if len(argv) > 1 else Path()
    before = sorted(folder.iterdir())
    assert run(*argv, *(["--out", folder / "run"] if len(argv) == 2 else [])) == 2
    captured = capsys.readouterr()
    assert not captured.out
    (line,) = captured.err.strip().splitlines()
    assert line.startswith("pinav: ")
    assert re.search(message, line), line
    assert sorted(folder.iterdir()) == before
