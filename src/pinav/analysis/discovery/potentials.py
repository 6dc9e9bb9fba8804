r"""The library of candidate laws: potentials, rotational forces, and their starts."""

import dataclasses
import itertools
import math
from typing import final

from pinav.analysis.discovery.geometries import (
    ANGLE,
    CENTER,
    Center,
    Ellipse,
    Line,
    ProfileLaw,
    rotate_axes,
)
from pinav.analysis.discovery.laws import AbstractLaw, Landscape, Turned
from pinav.forces.formulas import Constant, Constants, Expr, Functions, Role
from pinav.forces.profiles import (
    EVEN_PROFILES,
    HEIGHT,
    Channel,
    Gaussian,
    Harmonic,
    Ring,
    Step,
)


@final
@dataclasses.dataclass(frozen=True)
class ConstantForce(AbstractLaw):
    r"""$U = -a x - b y$: a slope, the same force everywhere."""

    name = "constant force"
    constants = (
        Constant("force_x", "a", Role.AMPLITUDE, "L T⁻²"),
        Constant("force_y", "b", Role.AMPLITUDE, "L T⁻²"),
    )

    def potential(self, c: Constants, x: Expr, y: Expr, f: Functions) -> Expr:
        return -c[0] * x - c[1] * y

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        return [(1.0, 1.0)]


@final
@dataclasses.dataclass(frozen=True)
class Saddle(AbstractLaw):
    r"""$U = -\tfrac12 a (u^2 - w^2) - b\, u w$ about a centre: a linear force."""

    name = "saddle"
    constants = (
        Constant("stretch", "a", Role.AMPLITUDE, "T⁻²"),
        Constant("shear", "b", Role.AMPLITUDE, "T⁻²"),
        *CENTER,
    )

    def potential(self, c: Constants, x: Expr, y: Expr, f: Functions) -> Expr:
        u, w = x - c[2], y - c[3]
        return -c[0] * (u**2 - w**2) / 2 - c[1] * u * w


@final
@dataclasses.dataclass(frozen=True)
class AnisotropicTrap(AbstractLaw):
    r"""$U = \tfrac12 (k_x u^2 + k_y w^2) - b\, u w$ about a centre."""

    name = "anisotropic trap"
    constants = (
        Constant("stiffness_x", "k_x", Role.AMPLITUDE, "T⁻²"),
        Constant("stiffness_y", "k_y", Role.AMPLITUDE, "T⁻²"),
        Constant("shear", "b", Role.AMPLITUDE, "T⁻²"),
        *CENTER,
    )

    def potential(self, c: Constants, x: Expr, y: Expr, f: Functions) -> Expr:
        u, w = x - c[3], y - c[4]
        return (c[0] * u**2 + c[1] * w**2) / 2 - c[2] * u * w

    def contains(self, other: AbstractLaw) -> bool:
        return other in (HARMONIC, SADDLE)


@final
@dataclasses.dataclass(frozen=True)
class PlaneWave(AbstractLaw):
    r"""$U = U_0\cos(k_x x + k_y y) + U_1\sin(k_x x + k_y y)$: a washboard."""

    name = "plane wave"
    constants = (
        Constant("cosine", "U_0", Role.AMPLITUDE, "L² T⁻²"),
        Constant("sine", "U_1", Role.AMPLITUDE, "L² T⁻²"),
        Constant("wavenumber_x", "k_x", Role.ANGLE, "L⁻¹"),
        Constant("wavenumber_y", "k_y", Role.ANGLE, "L⁻¹"),
    )

    def potential(self, c: Constants, x: Expr, y: Expr, f: Functions) -> Expr:
        phase = c[2] * x + c[3] * y
        return c[0] * f.cos(phase) + c[1] * f.sin(phase)

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        turns = [landscape.direction + math.pi * i / 8 for i in range(8)]
        return [
            (1.0, 1.0, k * math.cos(turn), k * math.sin(turn))
            for k, turn in itertools.product(wavenumbers(landscape), turns)
        ]


@final
@dataclasses.dataclass(frozen=True)
class Lattice(AbstractLaw):
    r"""$U = \sum_m a_m \cos(m \cdot \phi) + b_m \sin(m \cdot \phi)$.

    $\phi_i = k_i \cdot x$ with two wave vectors $k_1, k_2$.

    Attributes:
        orders: $m$ of the waves.
        constants: $a_m$ and $b_m$ of each wave, then the wave vectors.
    """

    orders: tuple[tuple[int, int], ...]
    name: str
    constants: tuple[Constant, ...] = dataclasses.field(init=False, repr=False)

    def __post_init__(self) -> None:
        amplitudes = [
            Constant(f"{word}_{i}", f"{symbol}_{i}", Role.AMPLITUDE, "L² T⁻²")
            for i in range(1, len(self.orders) + 1)
            for word, symbol in (("cosine", "a"), ("sine", "b"))
        ]
        vectors = [
            Constant(f"wavenumber_{axis}_{i}", f"k_{{{axis},{i}}}", Role.ANGLE, "L⁻¹")
            for i in (1, 2)
            for axis in "xy"
        ]
        object.__setattr__(self, "constants", (*amplitudes, *vectors))

    def potential(self, c: Constants, x: Expr, y: Expr, f: Functions) -> Expr:
        first = 2 * len(self.orders)
        one, two = c[first] * x + c[first + 1] * y, c[first + 2] * x + c[first + 3] * y
        phases = [m * one + n * two for m, n in self.orders]
        return sum(
            c[2 * i] * f.cos(phase) + c[2 * i + 1] * f.sin(phase)
            for i, phase in enumerate(phases)
        )

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        amplitudes = (1.0,) * (2 * len(self.orders))
        return [
            (*amplitudes, *one, *(sign * part for part in two))
            for one, two in _wave_vectors(landscape)
            for sign in (1.0, -1.0)
        ]

    def contains(self, other: AbstractLaw) -> bool:
        if isinstance(other, Lattice):
            return set(self.orders) > set(other.orders)
        return other == PLANE_WAVE


@final
@dataclasses.dataclass(frozen=True)
class DoubleWell(AbstractLaw):
    r"""$U = U_0 (u^2/a^2 - 1)^2 + \tfrac12 k w^2$ with axes turned by φ."""

    name = "double well"
    constants = (
        HEIGHT,
        Constant("stiffness", "k", Role.AMPLITUDE, "T⁻²"),
        *CENTER,
        Constant("half_distance", "a", Role.SCALE),
        ANGLE,
    )

    def potential(self, c: Constants, x: Expr, y: Expr, f: Functions) -> Expr:
        u, w = rotate_axes(x - c[2], y - c[3], c[5], f)
        return c[0] * (u**2 / c[4] ** 2 - 1) ** 2 + c[1] * w**2 / 2

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        angles = [landscape.direction + math.pi * i / 4 for i in range(4)]
        return [
            (1.0, 1.0, *center, length, angle)
            for center, length, angle in itertools.product(
                landscape.centers, landscape.lengths, angles
            )
        ]


def profile_laws(geometry: Center | Ellipse | Line) -> tuple[AbstractLaw, ...]:
    """The laws of every even profile in a geometry."""
    return tuple(ProfileLaw(profile, geometry) for profile in EVEN_PROFILES)


CONSTANT_FORCE, SADDLE, PLANE_WAVE = ConstantForce(), Saddle(), PlaneWave()
GAUSSIAN = ProfileLaw(Gaussian(), Center())
HARMONIC = ProfileLaw(Harmonic(), Center())
RING = ProfileLaw(Ring(), Center())
ANISOTROPIC_TRAP = AnisotropicTrap()
ELLIPTIC_GAUSSIAN = ProfileLaw(Gaussian(), Ellipse())
WALL, CHANNEL = ProfileLaw(Step(), Line()), ProfileLaw(Channel(), Line())
LATTICES = (
    Lattice(((1, 0), (0, 1)), "lattice of two waves"),
    Lattice(((1, 0), (0, 1), (1, 1)), "lattice of three waves"),
    Lattice(((1, 0), (0, 1), (1, 1), (1, -1)), "lattice of four waves"),
)

POTENTIALS: tuple[AbstractLaw, ...] = (
    CONSTANT_FORCE,
    *profile_laws(Center()),
    RING,
    ELLIPTIC_GAUSSIAN,
    SADDLE,
    WALL,
    CHANNEL,
    PLANE_WAVE,
    LATTICES[0],
    DoubleWell(),
)
"""Conservative candidates of a force of unknown structure."""


def wavenumbers(landscape: Landscape) -> list[float]:
    """Wavenumbers of which one half to six waves are within the data [rad L⁻¹]."""
    numbers = (1, 2, 3, 4, 6, 8, 10, 12)
    return [math.pi * waves / landscape.extent for waves in numbers]


Pair = tuple[tuple[float, float], tuple[float, float]]
"""Two vectors in the plane."""


def _wave_vectors(landscape: Landscape) -> list[Pair]:
    """Known wave vectors, or squares of many sizes and directions."""
    if landscape.wave_vectors:
        one, two = landscape.wave_vectors
        return [(one, two)]
    turns = [landscape.direction + math.pi * i / 8 for i in range(4)]
    return [
        (
            (k * math.cos(turn), k * math.sin(turn)),
            (-k * math.sin(turn), k * math.cos(turn)),
        )
        for k, turn in itertools.product(wavenumbers(landscape), turns)
    ]


@final
@dataclasses.dataclass(frozen=True)
class SolidRotation(AbstractLaw):
    r"""$\psi = -\tfrac12 \Omega r^2$: $\Omega\,(-(y - c_y),\ x - c_x)$."""

    name = "solid rotation"
    constants = (Constant("rate", r"\Omega", Role.AMPLITUDE, "T⁻²"), *CENTER)
    turns = True

    def potential(self, c: Constants, x: Expr, y: Expr, f: Functions) -> Expr:
        return -c[0] * ((x - c[1]) ** 2 + (y - c[2]) ** 2) / 2


SOLID_ROTATION = SolidRotation()
GAUSSIAN_SWIRL = Turned(GAUSSIAN, "Gaussian swirl")
SHEAR = Turned(ProfileLaw(Harmonic(), Line()), "shear")

SWIRLS: tuple[AbstractLaw, ...] = (
    SOLID_ROTATION,
    *(
        Turned(law, f"{law.name} swirl")
        for law in profile_laws(Center())
        if law.name != Harmonic.name
    ),
)
"""Swirls about a centre."""

SHEAR_LAYERS: tuple[AbstractLaw, ...] = (
    SHEAR,
    *(
        Turned(law, f"shear, {law.name}")
        for law in (*profile_laws(Line()), WALL, PLANE_WAVE)
        if law != SHEAR.law
    ),
)
"""Forces along the layers of a line."""

ROTATIONS: tuple[AbstractLaw, ...] = (GAUSSIAN_SWIRL, SOLID_ROTATION, SHEAR)
"""Candidates without a potential of a force of unknown structure."""

LIBRARY: tuple[AbstractLaw, ...] = (*POTENTIALS, *ROTATIONS)
"""Candidates of a force of unknown structure."""
