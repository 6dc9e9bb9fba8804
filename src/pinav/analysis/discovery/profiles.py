r"""Profiles: formulas of a potential along one coordinate.

$z$ is the distance from a centre, or the signed distance from a line; where a profile
is even it asks for $z^2$ alone. A profile and a geometry make a law
(`pinav.analysis.discovery.geometries`).
"""

import abc
import dataclasses
from typing import ClassVar, final

from pinav.analysis.discovery.laws import Constant, Constants, Expr, Functions, Role

HEIGHT = Constant("height", "U_0", Role.AMPLITUDE, "L² T⁻²")
WIDTH = Constant("width", r"\sigma", Role.SCALE)
CORE = Constant("core", "s", Role.SCALE)
EDGE = Constant("edge", "w", Role.SCALE)


@dataclasses.dataclass(frozen=True)
class AbstractProfile(abc.ABC):
    r"""A potential $U(z)$ of one coordinate.

    Attributes:
        name: what tables call it.
        amplitude: the constant that it is proportional to.
        shapes: its other constants.
        limits: names of the profiles that it becomes for special values of them.
    """

    name: ClassVar[str]
    amplitude: ClassVar[Constant] = HEIGHT
    shapes: ClassVar[tuple[Constant, ...]] = ()
    limits: ClassVar[tuple[str, ...]] = ()

    @abc.abstractmethod
    def value(self, c: Constants, z: Expr, f: Functions) -> Expr:
        """The potential for unit amplitude.

        Args:
            c: values of `shapes`.
            z: the coordinate [L].
            f: the functions that it is made of.
        """

    @abc.abstractmethod
    def starts(self, length: float) -> list[tuple[float, ...]]:
        """Values of `shapes` from which a fit may start.

        Args:
            length: over which the potential changes [L].
        """


class AbstractWidthProfile(AbstractProfile):
    """A profile of a single length."""

    def starts(self, length: float) -> list[tuple[float, ...]]:
        return [(length,)]


@final
class Harmonic(AbstractProfile):
    r"""$U = \tfrac12 k z^2$: a trap, or with k < 0 a hill without end."""

    name = "harmonic"
    amplitude = Constant("stiffness", "k", Role.AMPLITUDE, "T⁻²")

    def value(self, c: Constants, z: Expr, f: Functions) -> Expr:
        return z**2 / 2

    def starts(self, length: float) -> list[tuple[float, ...]]:
        return [()]


@final
class Gaussian(AbstractWidthProfile):
    r"""$U = U_0 \exp(-z^2 / 2\sigma^2)$: the paper's barrier, eq. (1)."""

    name = "Gaussian"
    shapes = (WIDTH,)

    def value(self, c: Constants, z: Expr, f: Functions) -> Expr:
        return f.exp(-(z**2) / (2 * c[0] ** 2))


@final
class Lorentzian(AbstractWidthProfile):
    r"""$U = U_0 / (1 + z^2/s^2)$."""

    name = "Lorentzian"
    shapes = (CORE,)

    def value(self, c: Constants, z: Expr, f: Functions) -> Expr:
        return 1 / (1 + z**2 / c[0] ** 2)


@final
class SquaredSech(AbstractWidthProfile):
    r"""$U = U_0\,\mathrm{sech}^2(z/w)$, as the product of two logistics, times four."""

    name = "squared sech"
    shapes = (EDGE,)

    def value(self, c: Constants, z: Expr, f: Functions) -> Expr:
        turned = 2 * z / c[0]
        return 4 * f.logistic(turned) * f.logistic(-turned)


@final
class SoftCoulomb(AbstractWidthProfile):
    r"""$U = U_0 / \sqrt{1 + z^2/s^2}$: a charge that is not screened, with a core."""

    name = "soft Coulomb"
    shapes = (CORE,)

    def value(self, c: Constants, z: Expr, f: Functions) -> Expr:
        return 1 / f.root(1 + z**2 / c[0] ** 2)


@final
class SoftLogarithm(AbstractWidthProfile):
    r"""$U = \tfrac12 A \log(1 + z^2/s^2)$: a line charge, or a vortex with a core."""

    name = "soft logarithm"
    amplitude = Constant("strength", "A", Role.AMPLITUDE, "L² T⁻²")
    shapes = (CORE,)

    def value(self, c: Constants, z: Expr, f: Functions) -> Expr:
        return f.log(1 + z**2 / c[0] ** 2) / 2


@final
class InversePower(AbstractProfile):
    r"""$U = U_0 (1 + z^2/s^2)^{-n/2}$: $1/z^n$ beyond a soft core."""

    name = "inverse power"
    shapes = (CORE, Constant("exponent", "n", Role.SCALE, "1"))
    limits = ("Gaussian", "Lorentzian", "soft Coulomb")

    def value(self, c: Constants, z: Expr, f: Functions) -> Expr:
        return f.exp(-c[1] * f.log(1 + z**2 / c[0] ** 2) / 2)

    def starts(self, length: float) -> list[tuple[float, ...]]:
        return [(length, 1.0), (length, 3.0)]


@final
class Yukawa(AbstractProfile):
    r"""$U = U_0\, s\, e^{-(\rho - s)/\lambda}/\rho$, $\rho = \sqrt{z^2 + s^2}$."""

    name = "Yukawa"
    shapes = (CORE, Constant("range", r"\lambda", Role.SCALE))
    limits = ("Gaussian", "soft Coulomb")

    def value(self, c: Constants, z: Expr, f: Functions) -> Expr:
        distance = f.root(z**2 + c[0] ** 2)
        return c[0] * f.exp(-(distance - c[0]) / c[1]) / distance

    def starts(self, length: float) -> list[tuple[float, ...]]:
        return [(length, 0.5 * length), (length, 2.0 * length)]


@final
class SoftDisc(AbstractProfile):
    r"""$U = U_0 / (1 + e^{(\rho - R)/w})$: a disc, or a band, with a soft edge.

    $\rho = \sqrt{z^2 + w^2}$ keeps the force smooth at the centre.
    """

    name = "soft disc"
    shapes = (Constant("radius", "R", Role.SCALE), EDGE)
    limits = ("logistic wall",)

    def value(self, c: Constants, z: Expr, f: Functions) -> Expr:
        return f.logistic((c[0] - f.root(z**2 + c[1] ** 2)) / c[1])

    def starts(self, length: float) -> list[tuple[float, ...]]:
        return [(length, 0.4 * length)]


@final
class Ring(AbstractProfile):
    r"""$U = U_0 \exp(-(z - R)^2 / 2\sigma^2)$: a ridge at the distance R."""

    name = "ring"
    shapes = (Constant("radius", "R", Role.SCALE), WIDTH)
    limits = ("Gaussian",)

    def value(self, c: Constants, z: Expr, f: Functions) -> Expr:
        return f.exp(-((z - c[0]) ** 2) / (2 * c[1] ** 2))

    def starts(self, length: float) -> list[tuple[float, ...]]:
        ratios = ((0.7, 0.3), (1.0, 0.3), (1.4, 0.4))
        return [(radius * length, width * length) for radius, width in ratios]


@final
class CompactHill(AbstractProfile):
    r"""$U = U_0 (1 - z^2/R^2)^n$ within R, and nothing beyond."""

    name = "compact hill"
    shapes = (
        Constant("radius", "R", Role.SCALE),
        Constant("exponent", "n", Role.SCALE, "1"),
    )
    limits = ("Gaussian",)

    def value(self, c: Constants, z: Expr, f: Functions) -> Expr:
        return f.positive_power(1 - z**2 / c[0] ** 2, c[1])

    def starts(self, length: float) -> list[tuple[float, ...]]:
        return [(2.0 * length, 2.0), (2.5 * length, 3.0), (4.0 * length, 6.0)]


@final
class SuperGaussian(AbstractProfile):
    r"""$U = U_0 \exp(-(z^2 / 2\sigma^2)^m)$: flat, or with m < 1 pointed."""

    name = "super-Gaussian"
    shapes = (WIDTH, Constant("steepness", "m", Role.SCALE, "1"))
    limits = ("Gaussian",)

    def value(self, c: Constants, z: Expr, f: Functions) -> Expr:
        square = z**2 / (2 * c[0] ** 2)
        return f.exp(-f.positive_power(square, c[1]))

    def starts(self, length: float) -> list[tuple[float, ...]]:
        return [(length, 0.7), (length, 1.6)]


@final
class Step(AbstractProfile):
    r"""$U = U_0 / (1 + e^{-z/w})$: a wall; along a line alone."""

    name = "logistic wall"
    shapes = (EDGE,)

    def value(self, c: Constants, z: Expr, f: Functions) -> Expr:
        return f.logistic(z / c[0])

    def starts(self, length: float) -> list[tuple[float, ...]]:
        return [(0.5 * length,)]


@final
class Channel(AbstractProfile):
    r"""$U = U_0 / (1 + e^{(a - z)/w}) + U_0 / (1 + e^{(a + z)/w})$: two equal walls."""

    name = "channel"
    shapes = (Constant("half_width", "a", Role.SCALE), EDGE)
    limits = ("logistic wall",)

    def value(self, c: Constants, z: Expr, f: Functions) -> Expr:
        return f.logistic((z - c[0]) / c[1]) + f.logistic((-z - c[0]) / c[1])

    def starts(self, length: float) -> list[tuple[float, ...]]:
        return [(length, 0.2 * length), (2.0 * length, 0.3 * length)]


EVEN_PROFILES: tuple[AbstractProfile, ...] = (
    Harmonic(),
    Gaussian(),
    Lorentzian(),
    SquaredSech(),
    SoftCoulomb(),
    SoftLogarithm(),
    InversePower(),
    Yukawa(),
    SoftDisc(),
    CompactHill(),
    SuperGaussian(),
)
"""Profiles of a distance from a point or a line."""
