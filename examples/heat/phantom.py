"""A synthetic phantom: four tissues, a hot spot and MR thermometry with known truth.

    python examples/heat/phantom.py --key 0 --out runs/phantom
    pinav heat learn runs/phantom/case.toml --out runs/phantom-learn
    pinav heat optimise runs/phantom/plan.toml --out runs/phantom-plan

`truth.toml` has the perfusion, the power and the place of the spot that the frames
were made with, all drawn with the key; `case.toml` starts from perfusion at rest, the
nominal power and the spot in the middle of the tumour. The frames have 1 K noise a
voxel, whole turns of the phase, a field that drifts, no signal in fat and lost voxels.
"""

import argparse
import importlib
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tomli_w

jax.config.update("jax_enable_x64", val=True)

from pinav.thermal.setup import Setup
from pinav.thermal.solve import solve

MUSCLE, FAT, LIVER, TUMOUR = 1, 2, 3, 4
TURN = 16.0
"""Temperature [K] of a turn of the phase."""

RESTS = {"muscle": 2.5, "fat": 0.4, "liver": 8.0, "tumour": 2.0}
"""Mass perfusion [kg/(m³ s)] of tissue that is heated already, from which the fit
starts; fat is not learned."""


def make_phantom(
    folder: Path,
    *,
    key: int,
    cells: tuple[int, int, int] = (48, 48, 24),
    size: tuple[float, float, float] = (3e-3, 3e-3, 4e-3),
    frames: int = 60,
    every: float = 60.0,
    noise: float = 1.0,
    suffix: str = "npy",
) -> None:
    """Write the cases `case.toml`, `plan.toml` and `truth.toml`, and their images.

    Args:
        folder: where to write; made if it is not there.
        key: of all that is random.
        cells: of the grid.
        size: of a cell [m].
        frames: number of them.
        every: time between two frames [s].
        noise: standard deviation of a reading [K], on average.
        suffix: `npy`, or `nii.gz` with nibabel.
    """
    folder.mkdir(parents=True, exist_ok=True)
    random = np.random.default_rng(key)
    places = [(np.arange(n) + 0.5) * h for n, h in zip(cells, size, strict=True)]
    lengths = np.array(cells) * size
    x = np.stack(np.meshgrid(*places, indexing="ij"))
    middle = lengths * random.uniform(0.45, 0.55, 3)
    labels = draw_tissues(x, lengths, middle, random)
    save = ArraysIn(folder, size, every, suffix)
    save("labels", labels.astype(np.int16))
    shift = random.uniform(-4e-3, 4e-3, 3)
    width = 0.12 * lengths[0]
    for name, place in (("sar", middle), ("true_sar", middle + shift)):
        squares = ((x - place[:, None, None, None]) ** 2).sum(axis=0)
        save(name, 150.0 * np.exp(-0.5 * squares / width**2))
    scale = random.uniform(0.8, 1.2)
    flows = {name: rest * random.uniform(0.6, 1.6) for name, rest in RESTS.items()}
    flows["fat"] = RESTS["fat"]
    content: dict[str, Any] = case(size, suffix, frames, every)
    truth: dict[str, Any] = content | {"title": f"The truth of phantom {key}"}
    truth["heating"] = truth["heating"] | {
        "file": f"true_sar.{suffix}",
        "scale": float(scale),
    }
    del truth["step"]  # its own steps are half as long
    truth["tissues"] = {
        name: table | {"perfusion": {"value": float(flows[name]), "unit": "kg/m3/s"}}
        for name, table in content["tissues"].items()
    }
    write(folder / "truth.toml", truth)
    heated, learned = read_frames(folder / "truth.toml", frames, every), LEARN
    sd = noise * random.uniform(0.7, 1.3, cells)
    save("noise", sd)
    save("temperature", corrupt(heated, sd, labels, random))
    learned["thermometry"] = {
        "readings": f"temperature.{suffix}",
        "noise": f"noise.{suffix}",
        "turn": TURN,
        "drift": "linear",
    } | ({"every": every} if suffix == "npy" else {})
    write(folder / "case.toml", content | {"learn": learned})
    plan = {"after": 10 * every, "largest": 1.4e4, "max_temperature": 47.0}
    write(folder / "plan.toml", content | {"learn": learned, "optimise": plan})


LEARN: dict[str, Any] = {
    "kind": "constant",
    "laws": ["muscle", "liver", "tumour"],
    "power_scale": True,
    "spot": True,
    "truth": "truth.toml",
}


def case(
    size: tuple[float, float, float], suffix: str, frames: int, every: float
) -> dict[str, Any]:
    """The case of a fit, without what is learned and from what."""
    tissues, duration = {}, frames * every
    for name, label in (
        ("muscle", MUSCLE),
        ("fat", FAT),
        ("liver", LIVER),
        ("tumour", TUMOUR),
    ):
        flow = {"value": RESTS[name], "unit": "kg/m3/s"}
        tissues[name] = {"label": label, "preset": name, "perfusion": flow}
    grid: dict[str, Any] = {"kind": "voxels", "labels": f"labels.{suffix}"}
    if suffix == "npy":
        grid["size"] = list(size)
    return {
        "title": "A phantom of four tissues",
        "target": ["tumour"],
        "step": every / 3,
        "grid": grid,
        "tissues": tissues,
        "heating": {"kind": "sar", "file": f"sar.{suffix}", "reference": 1e4},
        "field": {
            "frequency": 1e5,
            "times": [duration * k / 6 for k in range(7)],
            "amplitudes": [9e3, 7e3] * 3,
        },
    }


def draw_tissues(
    x: np.ndarray, lengths: np.ndarray, middle: np.ndarray, random: np.random.Generator
) -> np.ndarray:
    """Muscle with a layer of fat, liver on one side, and an irregular tumour."""
    labels = np.full(x.shape[1:], MUSCLE)
    wave = 0.03 * lengths[0] * np.sin(2 * np.pi * x[1] / lengths[1])
    labels[x[0] - middle[0] > 0.05 * lengths[0] + wave] = LIVER
    labels[x[1] < 0.12 * lengths[1]] = FAT
    offset = (x - middle[:, None, None, None]) / (
        lengths.min() * random.uniform(0.13, 0.18, 3)[:, None, None, None]
    )
    angle = np.arctan2(offset[1], offset[0])
    lobes = 1 + 0.2 * np.cos(3 * angle + random.uniform(0, 2 * np.pi))
    labels[(offset**2).sum(axis=0) < lobes**2] = TUMOUR
    return labels


def read_frames(path: Path, frames: int, every: float) -> np.ndarray:
    """Temperatures [°C] of the truth at the times of the frames."""
    setup = Setup.read(path)
    solution = solve(
        setup.model,
        setup.protocol,
        stepper=setup.stepper,
        save_at=every * np.arange(1, frames + 1),
    )
    return np.asarray(solution.observed)


def corrupt(
    frames: np.ndarray, sd: np.ndarray, labels: np.ndarray, random: np.random.Generator
) -> np.ndarray:
    """What a scanner would say: voxels by frames, NaN where there is no signal."""
    noisy = frames + sd * random.normal(size=frames.shape)
    lines = [np.linspace(-1, 1, n) for n in labels.shape]
    terms = np.stack([np.ones(labels.shape), *np.meshgrid(*lines, indexing="ij")])
    steps = random.normal(size=(len(frames), 4)) * [0.5, 0.2, 0.2, 0.2]
    noisy += np.tensordot(np.cumsum(steps, axis=0), terms, axes=1)
    wrapped = 37.0 + (noisy - 37.0 + TURN / 2) % TURN - TURN / 2
    lost = (labels == FAT) | (random.uniform(size=labels.shape) < 0.02)
    dropped = random.uniform(size=frames.shape) < 0.01
    wrapped[dropped | lost] = np.nan
    return np.moveaxis(wrapped, 0, -1)


class ArraysIn:
    """Writes images into a folder."""

    def __init__(
        self,
        folder: Path,
        size: tuple[float, float, float],
        every: float,
        suffix: str,
    ) -> None:
        self.folder, self.size, self.every = folder, size, every
        self.suffix = suffix

    def __call__(self, name: str, values: np.ndarray) -> None:
        """Write one."""
        path = self.folder / f"{name}.{self.suffix}"
        if self.suffix == "npy":
            np.save(path, values)
            return
        nibabel = importlib.import_module("nibabel")
        affine = np.diag([1e3 * h for h in self.size] + [1.0])
        kind = values.dtype if values.dtype.kind == "i" else np.float32
        image = nibabel.Nifti1Image(values.astype(kind), affine)
        image.header.set_xyzt_units("mm", "sec")
        if values.ndim == 4:
            image.header.set_zooms((*(1e3 * h for h in self.size), self.every))
        image.to_filename(path)


def write(path: Path, content: dict[str, Any]) -> None:
    """Write a case."""
    path.write_text(tomli_w.dumps(content), encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="A synthetic phantom.")
    parser.add_argument("--key", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/phantom"))
    parser.add_argument("--nifti", action="store_true", help="needs nibabel")
    options = parser.parse_args()
    make_phantom(
        options.out, key=options.key, suffix="nii.gz" if options.nifti else "npy"
    )
