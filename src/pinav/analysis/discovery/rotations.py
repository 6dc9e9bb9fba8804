"""The library of candidate laws: forces without a potential, and their starts."""

import math
from types import ModuleType

from pinav.analysis.discovery.laws import (
    AbstractLaw,
    AbstractRotation,
    Components,
    Constant,
    Constants,
    Expr,
    Landscape,
    Role,
)
from pinav.analysis.discovery.potentials import (
    ANGLE,
    CENTER,
    OFFSET,
    WIDTH,
    central_shapes,
    rotate_axes,
    square,
)


class Swirl(AbstractRotation):
    r"""$R = \Omega\,(-(y - c_y),\ x - c_x)\exp(-r^2/2\sigma^2)$: a Gaussian vortex."""

    name = "Gaussian swirl"
    constants = (Constant("rate", r"\Omega", Role.AMPLITUDE, "T⁻²"), *CENTER, WIDTH)

    def rotation(self, c: Constants, x: Expr, y: Expr, ops: ModuleType) -> Components:
        dx, dy = x - c[1], y - c[2]
        size = c[0] * ops.exp(-square(dx, dy) / (2 * c[3] ** 2))
        return -size * dy, size * dx

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        return central_shapes(landscape)


class SolidRotation(AbstractRotation):
    r"""$R = \Omega\,(-(y - c_y),\ x - c_x)$: it grows with the distance."""

    name = "solid rotation"
    constants = (Constant("rate", r"\Omega", Role.AMPLITUDE, "T⁻²"), *CENTER)

    def rotation(self, c: Constants, x: Expr, y: Expr, ops: ModuleType) -> Components:
        return -c[0] * (y - c[2]), c[0] * (x - c[1])

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        return [(1.0, *center) for center in landscape.centers]


class Shear(AbstractRotation):
    r"""$R = \gamma\,(w - d)\,(\cos\phi, \sin\phi)$, $w = -x\sin\phi + y\cos\phi$."""

    name = "shear"
    constants = (Constant("rate", r"\gamma", Role.AMPLITUDE, "T⁻²"), ANGLE, OFFSET)

    def rotation(self, c: Constants, x: Expr, y: Expr, ops: ModuleType) -> Components:
        size = c[0] * (rotate_axes(x, y, c[1], ops)[1] - c[2])
        return size * ops.cos(c[1]), size * ops.sin(c[1])

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        angles = [landscape.direction + math.pi * i / 4 for i in range(4)]
        return [
            (1.0, angle, -x * math.sin(angle) + y * math.cos(angle))
            for angle in angles
            for x, y in landscape.centers
        ]


ROTATIONS: tuple[AbstractLaw, ...] = (Swirl(), SolidRotation(), Shear())
"""Candidates without a potential."""
