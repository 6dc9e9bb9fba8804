r"""Laws with formulas of their own, and those of profiles that have a name here."""

import dataclasses
import itertools
import math
from typing import final

from pinav.forces.formulas import Constant, Constants, Expr, Functions, Role
from pinav.forces.geometries import (
    ANGLE,
    CENTER,
    AbstractGeometry,
    Center,
    Landscape,
    Line,
    Place,
    rotate_axes,
)
from pinav.forces.laws import AbstractLaw, ProfileLaw, Turned
from pinav.forces.profiles import (
    HEIGHT,
    PROFILES,
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
        Constant("force_x", "a", Role.AMPLITUDE, "L T-2"),
        Constant("force_y", "b", Role.AMPLITUDE, "L T-2"),
    )

    def potential(self, c: Constants, x: Place, f: Functions) -> Expr:
        return -c[0] * x[0] - c[1] * x[1]

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        return [(1.0, 1.0)]


@final
@dataclasses.dataclass(frozen=True)
class Saddle(AbstractLaw):
    r"""$U = -\tfrac12 a (u^2 - w^2) - b\, u w$ about a centre: a linear force."""

    name = "saddle"
    constants = (
        Constant("stretch", "a", Role.AMPLITUDE, "T-2"),
        Constant("shear", "b", Role.AMPLITUDE, "T-2"),
        *CENTER[:2],
    )

    def potential(self, c: Constants, x: Place, f: Functions) -> Expr:
        u, w = x[0] - c[2], x[1] - c[3]
        return -c[0] * (u**2 - w**2) / 2 - c[1] * u * w


@final
@dataclasses.dataclass(frozen=True)
class AnisotropicTrap(AbstractLaw):
    r"""$U = \tfrac12 (k_x u^2 + k_y w^2) - b\, u w$ about a centre."""

    name = "anisotropic trap"
    constants = (
        Constant("stiffness_x", "k_x", Role.AMPLITUDE, "T-2"),
        Constant("stiffness_y", "k_y", Role.AMPLITUDE, "T-2"),
        Constant("shear", "b", Role.AMPLITUDE, "T-2"),
        *CENTER[:2],
    )

    def potential(self, c: Constants, x: Place, f: Functions) -> Expr:
        u, w = x[0] - c[3], x[1] - c[4]
        return (c[0] * u**2 + c[1] * w**2) / 2 - c[2] * u * w

    def contains(self, other: AbstractLaw) -> bool:
        return other in (HARMONIC, SADDLE)


WAVE = (
    Constant("cosine", "a", Role.AMPLITUDE, "L2 T-2"),
    Constant("sine", "b", Role.AMPLITUDE, "L2 T-2"),
)
VECTOR = tuple(
    Constant(f"wavenumber_{axis}", f"k_{axis}", Role.ANGLE, "rad L-1") for axis in "xy"
)


@final
@dataclasses.dataclass(frozen=True)
class Lattice(AbstractLaw):
    r"""$U = \sum_m a_m \cos(m \cdot \phi) + b_m \sin(m \cdot \phi)$.

    $\phi_i = k_i \cdot x$ with two wave vectors $k_1, k_2$, or one: a washboard.

    Attributes:
        orders: $m$ of the waves.
        constants: $a_m$ and $b_m$ of each wave, then the wave vectors.
    """

    orders: tuple[tuple[int, ...], ...]
    name: str
    constants: tuple[Constant, ...] = dataclasses.field(init=False, repr=False)

    def __post_init__(self) -> None:
        waves, vectors = len(self.orders), len(self.orders[0])
        constants = (
            *(one.with_index(i + 1, waves) for i in range(waves) for one in WAVE),
            *(one.with_index(i + 1, vectors) for i in range(vectors) for one in VECTOR),
        )
        object.__setattr__(self, "constants", constants)

    @property
    def is_straight(self) -> bool:
        return len(self.orders) == 1

    def potential(self, c: Constants, x: Place, f: Functions) -> Expr:
        first = 2 * len(self.orders)
        ways = [
            c[first + 2 * i] * x[0] + c[first + 2 * i + 1] * x[1]
            for i in range(len(self.orders[0]))
        ]
        phases = [
            sum(m * way for m, way in zip(order, ways, strict=True))
            for order in self.orders
        ]
        return sum(
            c[2 * i] * f.cos(phase) + c[2 * i + 1] * f.sin(phase)
            for i, phase in enumerate(phases)
        )

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        amplitudes = (1.0,) * (2 * len(self.orders))
        if self.is_straight:
            waves = [wave for wave, _ in _squares(landscape, 8)]
            return [(*amplitudes, *wave) for wave in waves]
        pairs = [landscape.wave_vectors] if landscape.wave_vectors else []
        return [
            (*amplitudes, *one, *(sign * part for part in two))
            for one, two in pairs or _squares(landscape, 4)
            for sign in (1.0, -1.0)
        ]

    def contains(self, other: AbstractLaw) -> bool:
        return isinstance(other, Lattice) and len(self.orders) > len(other.orders)


Pair = tuple[tuple[float, float], tuple[float, float]]
"""Two vectors in the plane."""


def _squares(landscape: Landscape, turns: int) -> list[Pair]:
    """Wave vectors of squares of many sizes and directions [rad L⁻¹].

    Half a wave to six waves are within the data.
    """
    sizes = [math.pi * waves / landscape.extent for waves in (1, 2, 3, 4, 6, 8, 10, 12)]
    angles = [landscape.direction + math.pi * i / 8 for i in range(turns)]
    return [
        (
            (k * math.cos(angle), k * math.sin(angle)),
            (-k * math.sin(angle), k * math.cos(angle)),
        )
        for k, angle in itertools.product(sizes, angles)
    ]


@final
@dataclasses.dataclass(frozen=True)
class DoubleWell(AbstractLaw):
    r"""$U = U_0 (u^2/a^2 - 1)^2 + \tfrac12 k w^2$ with axes turned by φ."""

    name = "double well"
    constants = (
        HEIGHT,
        Constant("stiffness", "k", Role.AMPLITUDE, "T-2"),
        *CENTER[:2],
        Constant("half_distance", "a", Role.SCALE),
        ANGLE,
    )

    def potential(self, c: Constants, x: Place, f: Functions) -> Expr:
        u, w = rotate_axes(x[0] - c[2], x[1] - c[3], c[5], f)
        return c[0] * (u**2 / c[4] ** 2 - 1) ** 2 + c[1] * w**2 / 2

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        angles = [landscape.direction + math.pi * i / 4 for i in range(4)]
        return [
            (1.0, 1.0, *center, length, angle)
            for center, length, angle in itertools.product(
                landscape.centers, landscape.lengths, angles
            )
        ]


@final
@dataclasses.dataclass(frozen=True)
class SolidRotation(AbstractLaw):
    r"""$\psi = -\tfrac12 \Omega r^2$: $\Omega\,(-(y - c_y),\ x - c_x)$."""

    name = "solid rotation"
    constants = (Constant("rate", r"\Omega", Role.AMPLITUDE, "T-2"), *CENTER[:2])
    turns = True

    def potential(self, c: Constants, x: Place, f: Functions) -> Expr:
        return -c[0] * ((x[0] - c[1]) ** 2 + (x[1] - c[2]) ** 2) / 2


def profile_laws(geometry: AbstractGeometry) -> tuple[AbstractLaw, ...]:
    """The laws of every profile that is found in a geometry."""
    profiles = (one for one in PROFILES.values() if geometry.family in one.found_in)
    return tuple(ProfileLaw(profile, geometry) for profile in profiles)


def turn(law: AbstractLaw) -> AbstractLaw:
    """The law whose stream function is the potential of another."""
    return SOLID_ROTATION if law == HARMONIC else Turned(law)


CONSTANT_FORCE, SADDLE = ConstantForce(), Saddle()
GAUSSIAN = ProfileLaw(Gaussian(), Center())
HARMONIC = ProfileLaw(Harmonic(), Center())
RING = ProfileLaw(Ring(), Center())
ANISOTROPIC_TRAP = AnisotropicTrap()
WALL, CHANNEL = ProfileLaw(Step(), Line()), ProfileLaw(Channel(), Line())
PLANE_WAVE = Lattice(((1,),), "plane wave")
LATTICES = (
    Lattice(((1, 0), (0, 1)), "lattice of two waves"),
    Lattice(((1, 0), (0, 1), (1, 1)), "lattice of three waves"),
    Lattice(((1, 0), (0, 1), (1, 1), (1, -1)), "lattice of four waves"),
)
DOUBLE_WELL, SOLID_ROTATION = DoubleWell(), SolidRotation()
GAUSSIAN_SWIRL = Turned(GAUSSIAN)

FORMULAS: tuple[AbstractLaw, ...] = (
    CONSTANT_FORCE,
    SADDLE,
    ANISOTROPIC_TRAP,
    PLANE_WAVE,
    *LATTICES,
    DOUBLE_WELL,
    SOLID_ROTATION,
)
"""Laws that are no profile of a geometry."""
