"""Fields in space that are drawn by a key, and what `pinav fit` makes of recordings.

Even keys are for development, odd ones for judging. Recordings are those of the
scenario `box` with another field: 64 trajectories, positions alone, an error of 0.02.
"""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from pinav.evaluation import force_error_at_samples
from pinav.fitting import fit_structured, kernel_environment
from pinav.forces import (
    AbstractForce,
    GaussianBarrier,
    KernelPotential,
    LinearForce,
    PlaneWaves,
    SumForce,
    compact_hill,
    power_hill,
    ring_barrier,
    split_structure,
)
from pinav.scenarios.viscous import box
from pinav.trajectories import simulate

WAVES = 200
"""Of a random field."""

TRAJECTORIES = 64

Draw = Callable[[np.random.Generator], AbstractForce]


def _random(rng: np.random.Generator) -> AbstractForce:
    """A Gaussian random potential whose length scale is 1/4 to 1/3 of the box."""
    vectors = rng.normal(size=(WAVES, 3)) / rng.uniform(2.5, 3.3)
    size = np.sqrt(2.0 / WAVES) * rng.uniform(1.0, 2.0)
    return PlaneWaves(np.full(WAVES, size), vectors, rng.uniform(0, 2 * np.pi, WAVES))


def _height(rng: np.random.Generator) -> float:
    """Of a hill, or, once in three draws, of a well."""
    return float(rng.choice([1.0, 1.0, -1.0]) * rng.uniform(2.0, 5.0))


def _place(rng: np.random.Generator) -> list[float]:
    return rng.uniform(3.5, 6.5, 3).tolist()


def _gaussian(rng: np.random.Generator) -> AbstractForce:
    return GaussianBarrier(_height(rng), _place(rng), float(rng.uniform(1.5, 3.0)))


def _screened(rng: np.random.Generator) -> AbstractForce:
    return power_hill(_height(rng), _place(rng), float(rng.uniform(1.5, 2.5)), 0.5)


def _lorentzian(rng: np.random.Generator) -> AbstractForce:
    return power_hill(_height(rng), _place(rng), float(rng.uniform(1.5, 2.5)), 1.0)


def _compact(rng: np.random.Generator) -> AbstractForce:
    return compact_hill(_height(rng), _place(rng), float(rng.uniform(3.5, 6.0)))


def _shell(rng: np.random.Generator) -> AbstractForce:
    radius, width = rng.uniform(2.0, 4.0), rng.uniform(0.8, 1.2)
    height = float(rng.uniform(1.0, 2.0))
    return ring_barrier(height, _place(rng), float(radius), float(width))


def _linear(rng: np.random.Generator) -> AbstractForce:
    matrix = rng.uniform(-0.06, 0.06, (3, 3))
    return LinearForce((matrix + matrix.T) / 2, _place(rng))


def _hill_and_linear(rng: np.random.Generator) -> AbstractForce:
    return SumForce((_gaussian(rng), _linear(rng)))


FIELDS: dict[str, Draw] = {
    "random": _random,
    "gaussian": _gaussian,
    "screened": _screened,
    "lorentzian": _lorentzian,
    "compact": _compact,
    "shell": _shell,
    "linear": _linear,
    "hill and linear": _hill_and_linear,
}
"""Fields by their names; all but the first have a structure."""


class Score(NamedTuple):
    """What a fit of a drawn field came to.

    Attributes:
        field: its name and key.
        structure: kinds of the terms that were found.
        error: relative L2 error of the force at visited places.
        outcome: of the fit.
        kernels: of the free part.
        seconds: of a processor, compilation included.
    """

    field: str
    structure: str
    error: float
    outcome: str
    kernels: int
    seconds: float

    def __str__(self) -> str:
        return (
            f"{self.field:20s} {self.structure:20s} {self.error:8.2%}  "
            f"{self.outcome:16s} {self.kernels:5d} kernels {self.seconds:6.1f} s"
        )


def draw_field(name: str, key: int) -> AbstractForce:
    """The field of a name and a key."""
    return FIELDS[name](np.random.default_rng([16, list(FIELDS).index(name), key]))


def judge(name: str, key: int) -> Score:
    """Fit recordings of a drawn field as `pinav fit` does without options."""
    truth = draw_field(name, key)
    starts, noise = jax.random.split(jax.random.key(key))
    system = box(starts, TRAJECTORIES).with_truth(truth)
    data = simulate(system, key=noise)
    began = time.process_time()
    kernels = kernel_environment(KernelPotential, data, dim=3)
    model = system.swimmer.with_environment(kernels)
    fit = fit_structured(model, data, throw=False).fit
    seconds = time.process_time() - began
    learned = fit.model.environment
    terms, rest = split_structure(learned)
    free: Any = rest
    return Score(
        f"{name}, {key}",
        ", ".join(term.kind for term in terms) or "none",
        force_error_at_samples(learned, truth, data),
        fit.outcome.name,
        len(free.kernels.centers),
        seconds,
    )
