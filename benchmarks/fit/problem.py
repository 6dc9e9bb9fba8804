"""What a contestant is given and what it hands back.

Plain arrays, so that no tool has to import another one's library.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np


class Problem(NamedTuple):
    """Observations and known physics.

    Attributes:
        file: the same trajectories as pinav stores them.
        times: sample times [T], the same for every trajectory.
        states: observed states, trajectory by time by state.
        damping: known drag coefficient [T⁻¹].
        thrust: known constant thrust [L T⁻²].
        noise: standard deviation of the observations.
        began: time at which the process was launched [s].
    """

    file: Path
    times: np.ndarray
    states: np.ndarray
    damping: float
    thrust: np.ndarray
    noise: float
    began: float

    @classmethod
    def read(cls, file: Path, began: float) -> "Problem":
        """The problem beside a file of trajectories."""
        with np.load(physics_file(file)) as stored:
            arrays = {name: stored[name] for name in stored.files}
        return cls(
            file,
            arrays["times"],
            arrays["states"],
            float(arrays["damping"]),
            arrays["thrust"],
            float(arrays["noise"]),
            began,
        )


def physics_file(file: Path) -> Path:
    """Where the plain arrays beside a file of trajectories stand."""
    return file.with_name(f"{file.stem}-arrays.npz")


class Trained(NamedTuple):
    """A finished fit.

    Attributes:
        arrays: what was learned: `network_arrays` or the fields of a kernel.
        iterations: steps taken.
        full_seconds: time that the whole recipe would take [s], where it was cut.
        curve: seconds since the process began, and RMSE as the fit itself sees it.
        note: what the reader of the row should know.
    """

    arrays: dict[str, Any]
    iterations: int
    full_seconds: float | None = None
    curve: np.ndarray = np.zeros((0, 2))
    note: str = ""


def network_arrays(layers, center=(0.0, 0.0, 0.0), scale=(1.0, 1.0, 1.0)):
    """A network of (x, y, t) as named arrays: weight and bias of each layer."""
    arrays = {"center": np.asarray(center), "scale": np.asarray(scale)}
    for index, (weight, bias) in enumerate(layers):
        arrays[f"weight{index}"] = np.asarray(weight)
        arrays[f"bias{index}"] = np.asarray(bias)
    return arrays


class Pace(NamedTuple):
    """How far a loop came, and what the whole of it would take.

    Attributes:
        done: steps taken.
        total: steps of the recipe.
        seconds: time of the steps taken [s].
        first: time of the first step [s], compilation included.
    """

    done: int
    total: int
    seconds: float
    first: float

    @property
    def fraction(self) -> float:
        """Share of the steps that was taken."""
        return self.done / self.total

    @property
    def full_seconds(self) -> float:
        """Time of all steps [s], those not taken at the mean pace after the first."""
        if self.done == self.total:
            return self.seconds
        if self.done < 2:
            return self.first * self.total
        rest = (self.seconds - self.first) / (self.done - 1)
        return self.first + rest * (self.total - 1)


def paced(
    step: Callable[[], object],
    total: int,
    *,
    seconds: float = float("inf"),
    fraction: float = 1.0,
) -> Pace:
    """Call `step` for a share of `total` times, or until `seconds` have passed."""
    start = time.perf_counter()
    first = spent = 0.0
    done = 0
    limit = max(1, round(fraction * total)) if total else 0
    while done < limit and (done == 0 or spent < seconds):
        step()
        done += 1
        spent = time.perf_counter() - start
        first = first or spent
    return Pace(done, total, spent, first)


def whole_recipe(paces: list[Pace]) -> tuple[int, float | None, str]:
    """Steps taken, and where it was cut, time of the whole recipe and a note."""
    done = sum(pace.done for pace in paces)
    total = sum(pace.total for pace in paces)
    if done == total:
        return done, None, ""
    parts = " + ".join(f"{pace.done} of {pace.total}" for pace in paces)
    seconds = sum(pace.full_seconds for pace in paces)
    return done, seconds, f"cut short: {parts} steps were run"
