r"""Geometries of laws: the coordinates that a profile is a function of."""

import abc
import dataclasses
import itertools
import math
from typing import final

from pinav.analysis.discovery.laws import AbstractLaw, Landscape
from pinav.forces.formulas import Constant, Constants, Expr, Functions, Role
from pinav.forces.profiles import AbstractProfile

CENTER = (
    Constant("center_x", "c_x", Role.POSITION),
    Constant("center_y", "c_y", Role.POSITION),
)
ANGLE = Constant("angle", r"\phi", Role.ANGLE, "1")
OFFSET = Constant("offset", "d", Role.POSITION)

Expressions = tuple[Expr, ...]


@dataclasses.dataclass(frozen=True)
class AbstractGeometry(abc.ABC):
    """Coordinates in the plane, and the constants that place them."""

    @property
    @abc.abstractmethod
    def constants(self) -> tuple[Constant, ...]:
        """The constants that place them, in order."""

    @abc.abstractmethod
    def coordinates(self, c: Constants, x: Expr, y: Expr, f: Functions) -> Expressions:
        """The coordinates [L]; where there are several, their potentials add up."""

    @abc.abstractmethod
    def starts(self, landscape: Landscape) -> list[tuple[float, ...]]:
        """Constants from which a fit may start."""

    @abc.abstractmethod
    def name(self, profile: str) -> str:
        """Name of a law of this geometry and a profile, for tables."""

    def contains(self, other: "AbstractGeometry") -> bool:
        """True if the other one is a special case of this one, or the same."""
        return self == other


@final
class Center(AbstractGeometry):
    """The distance from a centre."""

    @property
    def constants(self) -> tuple[Constant, ...]:
        return CENTER

    def coordinates(self, c: Constants, x: Expr, y: Expr, f: Functions) -> Expressions:
        return (f.root((x - c[0]) ** 2 + (y - c[1]) ** 2),)

    def starts(self, landscape: Landscape) -> list[tuple[float, ...]]:
        return list(landscape.centers)

    def name(self, profile: str) -> str:
        return profile


@final
class Ellipse(AbstractGeometry):
    r"""$z = \sqrt{u^2/a + a w^2}$ with axes turned by φ: similar ellipses."""

    @property
    def constants(self) -> tuple[Constant, ...]:
        return (*CENTER, Constant("aspect", "a", Role.SCALE, "1"), ANGLE)

    def coordinates(self, c: Constants, x: Expr, y: Expr, f: Functions) -> Expressions:
        u, w = rotate_axes(x - c[0], y - c[1], c[3], f)
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

    def name(self, profile: str) -> str:
        return f"elliptic {profile}"

    def contains(self, other: AbstractGeometry) -> bool:
        return isinstance(other, Center | Ellipse)


@final
class Line(AbstractGeometry):
    r"""$z = x\cos\phi + y\sin\phi - d$: the signed distance from a line."""

    @property
    def constants(self) -> tuple[Constant, ...]:
        return ANGLE, OFFSET

    def coordinates(self, c: Constants, x: Expr, y: Expr, f: Functions) -> Expressions:
        return (rotate_axes(x, y, c[0], f)[0] - c[1],)

    def starts(self, landscape: Landscape) -> list[tuple[float, ...]]:
        angles = [landscape.direction + turn for turn in (0.0, math.pi / 2)]
        shifts = (-0.25 * landscape.extent, 0.0, 0.25 * landscape.extent)
        return [
            (angle, x * math.cos(angle) + y * math.sin(angle) + shift)
            for angle, (x, y), shift in itertools.product(
                angles, landscape.centers, shifts
            )
        ]

    def name(self, profile: str) -> str:
        return (
            profile if profile in ("logistic wall", "channel") else f"{profile} layer"
        )


@final
@dataclasses.dataclass(frozen=True)
class Centers(AbstractGeometry):
    """Distances from several centres, of obstacles of one kind."""

    count: int

    @property
    def constants(self) -> tuple[Constant, ...]:
        return tuple(
            dataclasses.replace(
                constant,
                name=f"{constant.name}_{index}",
                symbol=f"c_{{{axis},{index}}}",
            )
            for index in range(1, self.count + 1)
            for axis, constant in zip("xy", CENTER, strict=True)
        )

    def coordinates(self, c: Constants, x: Expr, y: Expr, f: Functions) -> Expressions:
        return tuple(
            f.root((x - c[2 * k]) ** 2 + (y - c[2 * k + 1]) ** 2)
            for k in range(self.count)
        )

    def starts(self, landscape: Landscape) -> list[tuple[float, ...]]:
        if len(landscape.centers) != self.count:
            return []
        return [tuple(itertools.chain.from_iterable(landscape.centers))]

    def name(self, profile: str) -> str:
        return f"{profile} at {self.count} places"


@final
@dataclasses.dataclass(frozen=True)
class ProfileLaw(AbstractLaw):
    """A profile of the coordinates of a geometry; its constants are those of both."""

    profile: AbstractProfile
    geometry: AbstractGeometry
    name: str = dataclasses.field(init=False, repr=False)
    constants: tuple[Constant, ...] = dataclasses.field(init=False, repr=False)

    def __post_init__(self) -> None:
        profile, places = self.profile, self.geometry.constants
        constants = (profile.amplitude, *places, *profile.shapes)
        object.__setattr__(self, "name", self.geometry.name(profile.name))
        object.__setattr__(self, "constants", constants)

    def potential(self, c: Constants, x: Expr, y: Expr, f: Functions) -> Expr:
        places = self.geometry.coordinates(c[1:], x, y, f)
        shapes = c[1 + len(self.geometry.constants) :]
        return c[0] * sum(self.profile.value(shapes, z, f) for z in places)

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        return [
            (1.0, *place, *shape)
            for place in self.geometry.starts(landscape)
            for length in landscape.lengths
            for shape in self.profile.starts(length)
        ]

    def contains(self, other: AbstractLaw) -> bool:
        if not isinstance(other, ProfileLaw):
            return False
        mine, theirs = self.profile, other.profile
        is_like = mine == theirs or theirs.name in mine.limits
        return self != other and is_like and self.geometry.contains(other.geometry)


def rotate_axes(x: Expr, y: Expr, angle: Expr, f: Functions) -> tuple[Expr, Expr]:
    """Coordinates along axes turned by `angle`."""
    cos, sin = f.cos(angle), f.sin(angle)
    return x * cos + y * sin, y * cos - x * sin
