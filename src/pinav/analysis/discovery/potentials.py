r"""The library of candidate laws: potentials, and their starts.

$r$ is the distance from the centre $(c_x, c_y)$.
"""

import itertools
import math
from types import ModuleType

from pinav.analysis.discovery.laws import (
    AbstractLaw,
    AbstractPotential,
    Components,
    Constant,
    Constants,
    Expr,
    Landscape,
    Role,
    SumLaw,
)

CENTER = (
    Constant("center_x", "c_x", Role.POSITION),
    Constant("center_y", "c_y", Role.POSITION),
)
HEIGHT = Constant("height", "U_0", Role.AMPLITUDE, "L² T⁻²")
WIDTH = Constant("width", r"\sigma", Role.SCALE)
ANGLE = Constant("angle", r"\phi", Role.ANGLE, "1")
OFFSET = Constant("offset", "d", Role.POSITION)


class ConstantForce(AbstractPotential):
    r"""$U = -a x - b y$: a slope, the same force everywhere."""

    name = "constant force"
    constants = (
        Constant("force_x", "a", Role.AMPLITUDE, "L T⁻²"),
        Constant("force_y", "b", Role.AMPLITUDE, "L T⁻²"),
    )

    def potential(self, c: Constants, x: Expr, y: Expr, ops: ModuleType) -> Expr:
        return -c[0] * x - c[1] * y

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        return [(1.0, 1.0)]


class Harmonic(AbstractPotential):
    r"""$U = \tfrac12 k r^2$: a trap, or with k < 0 a hill without end."""

    name = "harmonic"
    constants = (Constant("stiffness", "k", Role.AMPLITUDE, "T⁻²"), *CENTER)

    def potential(self, c: Constants, x: Expr, y: Expr, ops: ModuleType) -> Expr:
        return c[0] * square(x - c[1], y - c[2]) / 2

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        return [(1.0, *center) for center in landscape.centers]


class Gaussian(AbstractPotential):
    r"""$U = U_0 \exp(-r^2 / 2\sigma^2)$: the paper's barrier, eq. (1)."""

    name = "Gaussian"
    constants = (HEIGHT, *CENTER, WIDTH)

    def potential(self, c: Constants, x: Expr, y: Expr, ops: ModuleType) -> Expr:
        return c[0] * ops.exp(-square(x - c[1], y - c[2]) / (2 * c[3] ** 2))

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        return central_shapes(landscape)


class AnisotropicGaussian(AbstractPotential):
    r"""$U = U_0 \exp(-u^2/2\sigma_u^2 - w^2/2\sigma_w^2)$ with axes turned by φ."""

    name = "anisotropic Gaussian"
    constants = (
        HEIGHT,
        *CENTER,
        Constant("width_u", r"\sigma_u", Role.SCALE),
        Constant("width_w", r"\sigma_w", Role.SCALE),
        ANGLE,
    )

    def potential(self, c: Constants, x: Expr, y: Expr, ops: ModuleType) -> Expr:
        u, w = rotate_axes(x - c[1], y - c[2], c[5], ops)
        return c[0] * ops.exp(-(u**2) / (2 * c[3] ** 2) - w**2 / (2 * c[4] ** 2))

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        angles = [landscape.direction + turn for turn in (0.0, math.pi / 4)]
        return [
            (1.0, *center, ratio * length, length / ratio, angle)
            for center, length, ratio, angle in itertools.product(
                landscape.centers, landscape.lengths, (0.7, 1.4), angles
            )
        ]


class Lorentzian(AbstractPotential):
    r"""$U = U_0 / (1 + r^2/s^2)$."""

    name = "Lorentzian"
    constants = (HEIGHT, *CENTER, Constant("core", "s", Role.SCALE))

    def potential(self, c: Constants, x: Expr, y: Expr, ops: ModuleType) -> Expr:
        return c[0] / (1 + square(x - c[1], y - c[2]) / c[3] ** 2)

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        return central_shapes(landscape)


class InversePower(AbstractPotential):
    r"""$U = U_0 (1 + r^2/s^2)^{-n/2}$: $1/r^n$ beyond a soft core."""

    name = "inverse power"
    constants = (*Lorentzian.constants, Constant("exponent", "n", Role.SCALE, "1"))

    def potential(self, c: Constants, x: Expr, y: Expr, ops: ModuleType) -> Expr:
        base = 1 + square(x - c[1], y - c[2]) / c[3] ** 2
        return c[0] * ops.exp(-c[4] * ops.log(base) / 2)

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        return [(*start, n) for start in central_shapes(landscape) for n in (1.0, 3.0)]


class Yukawa(AbstractPotential):
    r"""$U = U_0\, s\, e^{-(\rho - s)/\lambda}/\rho$, $\rho = \sqrt{r^2 + s^2}$."""

    name = "Yukawa"
    constants = (*Lorentzian.constants, Constant("range", r"\lambda", Role.SCALE))

    def potential(self, c: Constants, x: Expr, y: Expr, ops: ModuleType) -> Expr:
        distance = ops.sqrt(square(x - c[1], y - c[2]) + c[3] ** 2)
        return c[0] * c[3] * ops.exp(-(distance - c[3]) / c[4]) / distance

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        return [
            (*start, times * start[3])
            for start in central_shapes(landscape)
            for times in (0.5, 2.0)
        ]


class SoftDisc(AbstractPotential):
    r"""$U = U_0 / (1 + e^{(\rho - R)/w})$: a disc with a soft edge.

    $\rho = \sqrt{r^2 + w^2}$ keeps the force smooth at the centre.
    """

    name = "soft disc"
    constants = (
        HEIGHT,
        *CENTER,
        Constant("radius", "R", Role.SCALE),
        Constant("edge", "w", Role.SCALE),
    )

    def potential(self, c: Constants, x: Expr, y: Expr, ops: ModuleType) -> Expr:
        distance = ops.sqrt(square(x - c[1], y - c[2]) + c[4] ** 2)
        return c[0] * _logistic((c[3] - distance) / c[4], ops)

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        return [(*start, 0.4 * start[3]) for start in central_shapes(landscape)]


class Wall(AbstractPotential):
    r"""$U = U_0 / (1 + e^{-(u - d)/w})$, $u = x\cos\phi + y\sin\phi$: a wall."""

    name = "logistic wall"
    constants = (HEIGHT, ANGLE, OFFSET, Constant("edge", "w", Role.SCALE))

    def potential(self, c: Constants, x: Expr, y: Expr, ops: ModuleType) -> Expr:
        u, _ = rotate_axes(x, y, c[1], ops)
        return c[0] * _logistic((u - c[2]) / c[3], ops)

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        angles = [landscape.direction + turn for turn in (0.0, math.pi / 2)]
        places = [
            (x * math.cos(angle) + y * math.sin(angle), angle)
            for angle in angles
            for x, y in landscape.centers
        ]
        shifts = (-0.25 * landscape.extent, 0.0, 0.25 * landscape.extent)
        return [
            (1.0, angle, place + shift, 0.5 * length)
            for (place, angle), shift, length in itertools.product(
                places, shifts, landscape.lengths
            )
        ]


class PlaneWave(AbstractPotential):
    r"""$U = U_0\cos(k_x x + k_y y) + U_1\sin(k_x x + k_y y)$: a washboard."""

    name = "plane wave"
    constants = (
        Constant("cosine", "U_0", Role.AMPLITUDE, "L² T⁻²"),
        Constant("sine", "U_1", Role.AMPLITUDE, "L² T⁻²"),
        Constant("wavenumber_x", "k_x", Role.ANGLE, "L⁻¹"),
        Constant("wavenumber_y", "k_y", Role.ANGLE, "L⁻¹"),
    )

    def potential(self, c: Constants, x: Expr, y: Expr, ops: ModuleType) -> Expr:
        phase = c[2] * x + c[3] * y
        return c[0] * ops.cos(phase) + c[1] * ops.sin(phase)

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        numbers = [math.pi * waves / landscape.extent for waves in (1, 2, 3, 4, 6, 8)]
        turns = [math.pi * i / 8 for i in range(8)]
        return [
            (1.0, 1.0, k * math.cos(turn), k * math.sin(turn))
            for k, turn in itertools.product(
                numbers, [landscape.direction + turn for turn in turns]
            )
        ]


class DoubleWell(AbstractPotential):
    r"""$U = U_0 (u^2/a^2 - 1)^2 + \tfrac12 k w^2$ with axes turned by φ."""

    name = "double well"
    constants = (
        HEIGHT,
        Constant("stiffness", "k", Role.AMPLITUDE, "T⁻²"),
        *CENTER,
        Constant("half_distance", "a", Role.SCALE),
        ANGLE,
    )

    def potential(self, c: Constants, x: Expr, y: Expr, ops: ModuleType) -> Expr:
        u, w = rotate_axes(x - c[2], y - c[3], c[5], ops)
        return c[0] * (u**2 / c[4] ** 2 - 1) ** 2 + c[1] * w**2 / 2

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        angles = [landscape.direction + math.pi * i / 4 for i in range(4)]
        return [
            (1.0, 1.0, *center, length, angle)
            for center, length, angle in itertools.product(
                landscape.centers, landscape.lengths, angles
            )
        ]


GAUSSIAN = Gaussian()

POTENTIALS: tuple[AbstractLaw, ...] = (
    ConstantForce(),
    Harmonic(),
    GAUSSIAN,
    AnisotropicGaussian(),
    Lorentzian(),
    InversePower(),
    Yukawa(),
    SoftDisc(),
    Wall(),
    PlaneWave(),
    DoubleWell(),
)
"""Conservative candidates; `TWO_GAUSSIANS` starts from the fit of one."""

TWO_GAUSSIANS = SumLaw((GAUSSIAN, GAUSSIAN))


def central_shapes(landscape: Landscape) -> list[tuple[float, ...]]:
    """Unit amplitude, a centre and a length."""
    return [
        (1.0, *center, length)
        for center, length in itertools.product(landscape.centers, landscape.lengths)
    ]


def square(dx: Expr, dy: Expr) -> Expr:
    """Squared length of a vector."""
    return dx**2 + dy**2


def rotate_axes(x: Expr, y: Expr, angle: Expr, ops: ModuleType) -> Components:
    """Coordinates along axes turned by `angle`."""
    cos, sin = ops.cos(angle), ops.sin(angle)
    return x * cos + y * sin, y * cos - x * sin


def _logistic(z: Expr, ops: ModuleType) -> Expr:
    """1/(1 + exp(-z)), which no z overflows."""
    return (1 + ops.tanh(z / 2)) / 2
