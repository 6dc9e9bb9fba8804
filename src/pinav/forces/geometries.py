r"""Geometries of laws: the coordinates that a profile is a function of."""

import abc
import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import ClassVar, final

from pinav.forces.formulas import Constant, Constants, Expr, Functions, Role
from pinav.forces.profiles import DISTANCES, LINES, AbstractProfile

CENTER = tuple(Constant(f"center_{i}", f"c_{i}", Role.POSITION) for i in "xyz")
ANGLE = Constant("angle", r"\phi", Role.ANGLE, "rad")
OFFSET = Constant("offset", "d", Role.POSITION)

Place = Sequence[Expr]
"""Coordinates x, y, ... of a position."""

Expressions = tuple[Expr, ...]


@dataclasses.dataclass(frozen=True)
class Landscape:
    """Features of a force field from which fits of laws start.

    Attributes:
        centers: where the centre of a central force may be [L].
        lengths: from short to long, at which the force may change [L].
        direction: angle of the axis along which the force is strongest.
        extent: longest side of the box around the points [L].
        aspect: of the ellipses that its contours may be, along the axis over across.
        wave_vectors: two of a lattice [rad L⁻¹], where they are known.
    """

    centers: tuple[tuple[float, float], ...]
    lengths: tuple[float, ...]
    direction: float
    extent: float
    aspect: float = 1.0
    wave_vectors: tuple[tuple[float, float], ...] = ()


@dataclasses.dataclass(frozen=True)
class AbstractGeometry(abc.ABC):
    """Coordinates of a position, and the constants that place them.

    Attributes:
        family: word by which profiles say that they are found in it.
    """

    family: ClassVar[str] = DISTANCES

    @property
    @abc.abstractmethod
    def constants(self) -> tuple[Constant, ...]:
        """The constants that place them, in order."""

    @abc.abstractmethod
    def coordinates(self, c: Constants, x: Place, f: Functions) -> Expressions:
        """The coordinates [L]; where there are several, their potentials add up."""

    @abc.abstractmethod
    def starts(self, landscape: Landscape) -> list[tuple[float, ...]]:
        """Constants from which a fit may start."""

    @abc.abstractmethod
    def name(self, profile: AbstractProfile) -> str:
        """Name of a law of this geometry and a profile, for tables."""

    def contains(self, other: "AbstractGeometry") -> bool:
        """True if the other one is a special case of this one, or the same."""
        return self == other


@final
@dataclasses.dataclass(frozen=True)
class Center(AbstractGeometry):
    """The distance from a centre, in a plane or another space; or from several."""

    dim: int = 2
    count: int = 1

    @property
    def constants(self) -> tuple[Constant, ...]:
        return tuple(
            constant.with_index(index, self.count)
            for index in range(1, self.count + 1)
            for constant in CENTER[: self.dim]
        )

    def coordinates(self, c: Constants, x: Place, f: Functions) -> Expressions:
        dim = self.dim
        return tuple(
            f.root(sum((x[i] - c[dim * k + i]) ** 2 for i in range(dim)))
            for k in range(self.count)
        )

    def starts(self, landscape: Landscape) -> list[tuple[float, ...]]:
        if self.count == 1:
            return list(landscape.centers)
        if len(landscape.centers) != self.count:
            return []
        return [tuple(itertools.chain.from_iterable(landscape.centers))]

    def name(self, profile: AbstractProfile) -> str:
        if self.count > 1:
            return f"{profile.name} at {self.count} places"
        return f"round {profile.name}" if profile.is_straight else profile.name


@final
class Ellipse(AbstractGeometry):
    r"""$z = \sqrt{u^2/a + a w^2}$ with axes turned by φ: similar ellipses."""

    @property
    def constants(self) -> tuple[Constant, ...]:
        return (*CENTER[:2], Constant("aspect", "a", Role.SCALE, "1"), ANGLE)

    def coordinates(self, c: Constants, x: Place, f: Functions) -> Expressions:
        u, w = rotate_axes(x[0] - c[0], x[1] - c[1], c[3], f)
        return (f.root(u**2 / c[2] + c[2] * w**2),)

    def starts(self, landscape: Landscape) -> list[tuple[float, ...]]:
        angles = [landscape.direction + turn for turn in (0.0, math.pi / 4)]
        aspects = (0.5, 2.0) if landscape.aspect == 1.0 else (landscape.aspect,)
        return [
            (*center, aspect, angle)
            for center, aspect, angle in itertools.product(
                landscape.centers, aspects, angles
            )
        ]

    def name(self, profile: AbstractProfile) -> str:
        return f"elliptic {profile.name}"

    def contains(self, other: AbstractGeometry) -> bool:
        return isinstance(other, Center | Ellipse)


@final
class Line(AbstractGeometry):
    r"""$z = x\cos\phi + y\sin\phi - d$: the signed distance from a line."""

    family = LINES

    @property
    def constants(self) -> tuple[Constant, ...]:
        return ANGLE, OFFSET

    def coordinates(self, c: Constants, x: Place, f: Functions) -> Expressions:
        return (rotate_axes(x[0], x[1], c[0], f)[0] - c[1],)

    def starts(self, landscape: Landscape) -> list[tuple[float, ...]]:
        angles = [landscape.direction + turn for turn in (0.0, math.pi / 2)]
        shifts = (-0.25 * landscape.extent, 0.0, 0.25 * landscape.extent)
        return [
            (angle, x * math.cos(angle) + y * math.sin(angle) + shift)
            for angle, (x, y), shift in itertools.product(
                angles, landscape.centers, shifts
            )
        ]

    def name(self, profile: AbstractProfile) -> str:
        return profile.name if profile.is_straight else f"{profile.name} layer"


def rotate_axes(x: Expr, y: Expr, angle: Expr, f: Functions) -> tuple[Expr, Expr]:
    """Coordinates along axes turned by `angle`."""
    cos, sin = f.cos(angle), f.sin(angle)
    return x * cos + y * sin, y * cos - x * sin
