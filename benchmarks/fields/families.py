"""Families of systems whose environment is drawn by a key: what fits are tried on.

Each draw has its own field, thrust and drag; starts, times and noise are those of
`barrier_crossings` with 16 shots. Even keys are for development, odd ones for judging.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from benchmarks.fields.outside import OUTSIDE
from pinav.actuation import RotatingField
from pinav.dynamics import Swimmer
from pinav.errors import InputError
from pinav.forces import (
    AbstractForce,
    ConstantForce,
    GaussianBarrier,
    LinearDrag,
    LinearForce,
    MagneticPropulsion,
    PlaneWaves,
    SumForce,
    Superposition,
    ZeroForce,
    compact_hill,
    gaussian_ridge,
    gaussian_swirl,
    power_hill,
    ring_barrier,
    soft_wall,
)
from pinav.scenarios.planar import MANY, planar_system
from pinav.systems import System

Draw = Callable[[np.random.Generator], AbstractForce]


class Family(NamedTuple):
    """A kind of field.

    Attributes:
        draw: the field by random numbers.
        structure: names of the terms that make it, sorted; none where it has none.
        laws: names of the laws of these terms, as `pinav discover` calls them, sorted.
    """

    draw: Draw
    structure: tuple[str, ...] = ()
    laws: tuple[str, ...] = ()


def random_system(family: str, key: int) -> System:
    """A system of a family, drawn by its key alone.

    Thrust and drag are drawn, too: a thrust of 0.01 to 0.1 in a random direction, a
    drag of 0.2 to 0.5. The shots are those of `barrier_crossings`, 16 of them. Use even
    keys to develop a method and odd ones to judge it.

    Args:
        family: a key of `FAMILIES`.
        key: not negative.

    Raises:
        InputError: there is no such family, or `key` is negative.
    """
    if family not in FAMILIES:
        raise InputError(
            f"family {family!r} is unknown; choose one of: {', '.join(FAMILIES)}"
        )
    if key < 0:
        raise InputError(f"random_system key: expected >= 0, got {key}")
    index = list(FAMILIES).index(family)
    rng = np.random.default_rng([15, index, key])
    direction = rng.uniform(0.0, 2 * np.pi)
    truth = Swimmer(
        propulsion=MagneticPropulsion(
            field=RotatingField(amplitude=1.0, frequency=2 * np.pi),
            moment=[0.0, 0.0, 1.0],
            gain=float(rng.uniform(0.01, 0.1)),
            axis=[float(np.cos(direction)), float(np.sin(direction))],
        ),
        drag=LinearDrag(damping=float(rng.uniform(0.2, 0.5))),
        environment=FAMILIES[family].draw(rng),
    )
    rule = dataclasses.replace(MANY, seed=int(rng.integers(2**31)))
    return planar_system(f"{family}-{key}", truth, rule).with_starts()


def _place(rng: np.random.Generator, spread: float = 1.5) -> list[float]:
    return [float(5.0 + rng.uniform(-spread, spread)) for _ in range(2)]


def _height(rng: np.random.Generator) -> float:
    """Of a hill that some swimmers climb, or of a well."""
    return float(rng.choice([1.0, 1.0, -1.0]) * rng.uniform(2.0, 6.0))


def _gaussian(rng: np.random.Generator) -> AbstractForce:
    return GaussianBarrier(_height(rng), _place(rng), float(rng.uniform(1.5, 3.0)))


def _screened_force(rng: np.random.Generator) -> AbstractForce:
    return power_hill(_height(rng), _place(rng), float(rng.uniform(1.5, 2.5)), 0.5)


def _lorentzian(rng: np.random.Generator) -> AbstractForce:
    return power_hill(_height(rng), _place(rng), float(rng.uniform(1.0, 2.5)), 1.0)


def _compact(rng: np.random.Generator) -> AbstractForce:
    return compact_hill(_height(rng), _place(rng), float(rng.uniform(3.5, 6.0)))


def _ring(rng: np.random.Generator) -> AbstractForce:
    radius, width = rng.uniform(2.0, 4.0), rng.uniform(0.7, 1.2)
    height = float(rng.uniform(1.5, 4.0))
    return ring_barrier(height, _place(rng), float(radius), float(width))


def _ridge(rng: np.random.Generator) -> AbstractForce:
    length, width = rng.uniform(2.5, 4.0), rng.uniform(1.0, 1.5)
    angle = float(rng.uniform(0.0, np.pi))
    return gaussian_ridge(_height(rng), _place(rng), float(length), float(width), angle)


def _wall(rng: np.random.Generator) -> AbstractForce:
    angle, width = rng.uniform(0.0, 2 * np.pi), rng.uniform(0.6, 1.2)
    middle = 5.0 * (np.cos(angle) + np.sin(angle))
    offset = middle + rng.uniform(0.0, 3.0)
    height = float(rng.uniform(3.0, 8.0))
    return soft_wall(height, float(angle), float(offset), float(width))


def _channel(rng: np.random.Generator) -> AbstractForce:
    angle, half = rng.uniform(0.0, np.pi), rng.uniform(2.5, 4.0)
    middle = 5.0 * (np.cos(angle) + np.sin(angle)) + rng.uniform(-1.0, 1.0)
    width, height = float(rng.uniform(0.6, 1.2)), float(rng.uniform(3.0, 8.0))
    return SumForce(
        (
            soft_wall(height, float(angle), float(middle + half), width),
            soft_wall(height, float(angle + np.pi), float(half - middle), width),
        )
    )


def _lattice(rng: np.random.Generator) -> AbstractForce:
    period, angle = rng.uniform(4.0, 7.0), rng.uniform(0.0, np.pi / 2)
    along = np.array([np.cos(angle), np.sin(angle)]) * 2 * np.pi / period
    vectors = np.stack([along, [-along[1], along[0]]])
    amplitude = np.full(2, rng.uniform(0.6, 1.2))
    return PlaneWaves(amplitude, vectors, rng.uniform(0.0, 2 * np.pi, 2))


def _obstacles(rng: np.random.Generator) -> AbstractForce:
    height, width = float(rng.uniform(2.0, 4.0)), float(rng.uniform(0.9, 1.3))
    angle = rng.uniform(0.0, 2 * np.pi)
    turns = angle + 2 * np.pi * (np.arange(3) + rng.uniform(-0.1, 0.1, 3)) / 3
    places = 5.0 + 3.0 * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    hills = [GaussianBarrier(height, jnp.asarray(place), width) for place in places]
    return Superposition(
        eqx.filter_vmap(GaussianBarrier)(
            jnp.full(3, height),
            jnp.stack([h.center for h in hills]),
            jnp.full(3, width),
        )
    )


def _smooth(degrees: float) -> Draw:
    """A random field of length scale 2.2; Matern of order degrees / 2, or smooth."""

    def draw(rng: np.random.Generator) -> AbstractForce:
        directions = rng.normal(size=(WAVES, 2)) / 2.2
        if np.isfinite(degrees):
            scale = np.sqrt(rng.chisquare(degrees, size=(WAVES, 1)) / degrees)
            directions = directions / scale
        size = np.sqrt(2.0 / WAVES) * rng.uniform(1.0, 2.0)
        phases = rng.uniform(0.0, 2 * np.pi, WAVES)
        return PlaneWaves(np.full(WAVES, size), directions, phases)

    return draw


WAVES = 100
"""Of a random field."""


def _vortex(rng: np.random.Generator) -> AbstractForce:
    strength = float(rng.choice([-1.0, 1.0]) * rng.uniform(2.0, 5.0))
    return gaussian_swirl(strength, _place(rng), float(rng.uniform(1.5, 3.0)))


def _matrix(rng: np.random.Generator, *, turning: bool) -> Float[np.ndarray, "2 2"]:
    stretch, across, turn = rng.uniform([-0.03, -0.03, 0.02], [0.03, 0.03, 0.08])
    matrix = np.array([[stretch, across], [across, -stretch]])
    return matrix + turning * turn * np.array([[0.0, -1.0], [1.0, 0.0]])


def _saddle(rng: np.random.Generator) -> AbstractForce:
    return LinearForce(_matrix(rng, turning=False), _place(rng))


def _segment(rng: np.random.Generator) -> AbstractForce:
    """A long obstacle, four to nine times as long as wide."""
    length, width = float(rng.uniform(4.0, 6.0)), float(rng.uniform(0.7, 1.0))
    height, angle = float(rng.uniform(2.0, 5.0)), float(rng.uniform(0.0, np.pi))
    return gaussian_ridge(height, _place(rng), length, width, angle)


def _stripes(rng: np.random.Generator) -> AbstractForce:
    period, angle = rng.uniform(3.0, 7.0), rng.uniform(0.0, np.pi)
    along = np.array([[np.cos(angle), np.sin(angle)]]) * 2 * np.pi / period
    return PlaneWaves(rng.uniform(0.6, 1.5, 1), along, rng.uniform(0.0, 2 * np.pi, 1))


def _sum(*draws: Draw) -> Draw:
    return lambda rng: SumForce(tuple(draw(rng) for draw in draws))


NAMES = {
    "two-hills-wall": ("central", "wall"),
    "vortex-pair": ("central swirl",),
    "two-harmonics": ("lattice",),
    "defect": ("central", "lattice"),
    "flung-vortex": ("central swirl", "linear"),
}
"""Structures of the fields outside that are sums of terms of the search."""

FAMILIES: dict[str, Family] = {
    "gaussian": Family(_gaussian, ("central",), ("Gaussian",)),
    "screened": Family(_screened_force, ("central",), ("soft Coulomb",)),
    "lorentzian": Family(_lorentzian, ("central",), ("Lorentzian",)),
    "compact": Family(_compact, ("central",), ("compact hill",)),
    "ring": Family(_ring, ("central",), ("ring",)),
    "elliptic": Family(_ridge, ("elliptic",), ("elliptic Gaussian",)),
    "wall": Family(_wall, ("wall",), ("logistic wall",)),
    "channel": Family(_channel, ("wall",), ("channel",)),
    "lattice": Family(_lattice, ("lattice",), ("lattice of two waves",)),
    "obstacles": Family(_obstacles, ("obstacles",), ("Gaussian at 3 places",)),
    "random-smooth": Family(_smooth(np.inf)),
    "random-matern-5/2": Family(_smooth(5.0)),
    "random-matern-3/2": Family(_smooth(3.0)),
    "saddle": Family(_saddle, ("linear",), ("saddle",)),
    "vortex": Family(_vortex, ("central swirl",), ("Gaussian swirl",)),
    "vortex-saddle": Family(
        _sum(_vortex, _saddle),
        ("central swirl", "linear"),
        ("Gaussian swirl", "saddle"),
    ),
    "hill-wall": Family(
        _sum(_gaussian, _wall), ("central", "wall"), ("Gaussian", "logistic wall")
    ),
    "hill-saddle": Family(
        _sum(_compact, _saddle), ("central", "linear"), ("compact hill", "saddle")
    ),
    "uniform": Family(
        lambda rng: ConstantForce(rng.uniform(-0.3, 0.3, 2)),
        ("linear",),
        ("constant force",),
    ),
    "none": Family(lambda rng: ZeroForce()),
    # a draw depends on the place of its family: later ones stand at the end
    "segment": Family(_segment, ("elliptic",), ("elliptic Gaussian",)),
    "stripes": Family(_stripes, ("wall",), ("plane wave",)),
    "ridge-wall": Family(
        _sum(_ridge, _wall),
        ("elliptic", "wall"),
        ("elliptic Gaussian", "logistic wall"),
    ),
} | {name: Family(draw, NAMES.get(name, ())) for name, draw in OUTSIDE.items()}
"""Families by their names, with the structure that a search should name."""

INSIDE = tuple(name for name in FAMILIES if name not in OUTSIDE)
"""Families that the search has hypotheses for, or that have no structure."""
