"""Cases of `pinav heat`: a ball of the examples, voxels, and how tasks refuse them."""

import copy
import re
import tomllib
from pathlib import Path

import jax
import numpy as np
import tomli_w

from pinav import cli

EXAMPLES = Path(__file__).parents[1] / "examples" / "heat"
SHAPE, SIZE = (7, 6, 5), (2e-3, 2e-3, 4e-3)
FLOW = {"value": 1.0, "unit": "kg/m3/s"}
NUMBERS = {"conductivity": 0.5, "density": 1000.0, "specific_heat": 3500.0}
GONE = "left out"
"""In place of a value: the key is not there."""

LABELS = np.ones(SHAPE, np.int16)
"""A block of 4 within 1, a layer of 9."""
LABELS[2:5, 2:4, 1:3], LABELS[:, 0] = 4, 9

PLANE = {
    "grid": {"kind": "box", "cells": [24, 24], "size": 2e-3},
    "probes.points": [[0.02, 0.02]],
}


def ball(name="tumour"):
    """A case of the examples, on a coarse grid."""
    content = tomllib.loads((EXAMPLES / f"{name}.toml").read_text())
    content["grid"]["cells"] = 24
    return content


def small(name, folder, changes=None):
    """The file of an example on a coarse grid, with steps of 20 s and changes."""
    content = change(ball(name) | {"step": 20.0}, changes or {})
    return write(folder, content, name=f"{name}.toml")


def voxels():
    """A case on `LABELS`."""
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
    }


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


def write(folder, content, files=None, name="case.toml"):
    """A case and the files that it names, by their names: its path."""
    for file, values in (files or {}).items():
        if isinstance(values, bytes):
            (folder / file).write_bytes(values)
        elif isinstance(values, dict):
            (folder / file).write_text(tomli_w.dumps(values))
        else:
            np.save(folder / file, values)
    (folder / name).write_text(tomli_w.dumps(content))
    return folder / name


def run(*argv):
    """The exit code of `pinav heat`."""
    with jax.numpy_dtype_promotion("standard"):
        return cli.run(["heat", *map(str, argv)])


def refusal(capsys, *argv):
    """The one line that a command is refused with."""
    assert run(*argv) == cli.USAGE_ERROR
    captured = capsys.readouterr()
    assert not captured.out
    (line,) = captured.err.strip().splitlines()
    assert line.startswith("pinav: ")
    return line


def refuse(capsys, task, case, message):
    """Run a task that is refused with a message: nothing is written beside the case."""
    before = sorted(case.parent.iterdir())
    line = refusal(capsys, task, case, "--out", case.parent / "run")
    assert re.search(message, line), line
    assert sorted(case.parent.iterdir()) == before
