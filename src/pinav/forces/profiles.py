r"""Profiles: formulas of a potential along one coordinate.

$z$ is the distance from a centre, or the signed distance from a line. The barrier of a
scenario, the law that a term of a fit follows and the law that is discovered have the
same profiles. A new profile is one class here: files state it by its name, LaTeX and
the explorer know its formula, discovery tries it in the geometries of `found_in`, and
fits of a structure in those of `fitted_in`, by its `numbers`.
"""

import abc
import dataclasses
from typing import ClassVar, final

import numpy as np

from pinav.forces.fitted_numbers import (
    FORM,
    PERIOD,
    PLACE,
    SIZE,
    STEEPNESS,
    Number,
    Span,
)
from pinav.forces.formulas import Constant, Constants, Expr, Functions, Role

HEIGHT = Constant("height", "U_0", Role.AMPLITUDE, "L2 T-2")
WIDTH = Constant("width", r"\sigma", Role.SCALE)
CORE = Constant("core", "s", Role.SCALE)
EDGE = Constant("edge", "w", Role.SCALE)
RADIUS = Constant("radius", "R", Role.SCALE)
EXPONENT = Constant("exponent", "n", Role.SCALE, "1")
TAIL = Constant("tail", r"\kappa", Role.SCALE, "1")

DISTANCES, LINES = "distances", "lines"
"""Geometries: distances from points, and signed distances from a line."""


@dataclasses.dataclass(frozen=True)
class AbstractProfile(abc.ABC):
    r"""A potential $U(z)$ of one coordinate.

    Attributes:
        ratios: values of `shapes` from which a fit may start: of a length relative to
            the length over which the potential changes, of a number itself.
        limits: names of the profiles that it becomes for special values of them.
        found_in: geometries in which discovery tries it: `DISTANCES`, `LINES`.
        fitted: word of fits of a structure for it; empty where they do not try it.
        fitted_in: geometries whose terms may follow it.
        numbers: its constants in fits: the place along the coordinate first where it
            has one, else it stands at zero; then `shapes`. The first that is no length
            as it is tells the distance over which the potential falls.
    """

    name: ClassVar[str]
    amplitude: ClassVar[Constant] = HEIGHT
    shapes: ClassVar[tuple[Constant, ...]] = ()
    ratios: ClassVar[tuple[tuple[float, ...], ...]] = ((1.0,),)
    limits: ClassVar[tuple[str, ...]] = ()
    found_in: ClassVar[tuple[str, ...]] = (DISTANCES, LINES)
    fitted: ClassVar[str] = ""
    fitted_in: ClassVar[tuple[str, ...]] = ()
    numbers: ClassVar[tuple[Number, ...]] = ()

    @property
    def is_straight(self) -> bool:
        """True if its name says that it is one along a line."""
        return self.found_in == (LINES,)

    @property
    def is_placed(self) -> bool:
        """True if in a fit it has a place."""
        return len(self.numbers) > len(self.shapes)

    @abc.abstractmethod
    def value(self, c: Constants, z: Expr, f: Functions) -> Expr:
        """The potential at z [L] for unit amplitude; c are values of `shapes`."""

    def of_square(self, c: Constants, q: Expr, f: Functions) -> Expr:
        """The potential for unit amplitude at a squared coordinate [L²]."""
        return self.value(c, f.root(q), f)

    def starts(self, length: float) -> list[tuple[float, ...]]:
        """Starting values of `shapes`; the potential changes over `length` [L]."""
        units = [length if shape.unit == "L" else 1.0 for shape in self.shapes]
        return [
            tuple(ratio * unit for ratio, unit in zip(ratios, units, strict=True))
            for ratios in self.ratios
        ]


class AbstractEvenProfile(AbstractProfile):
    """A profile of the squared distance, so that its force is smooth at a centre."""

    def value(self, c: Constants, z: Expr, f: Functions) -> Expr:
        return self.of_square(c, z**2, f)

    @abc.abstractmethod
    def of_square(self, c: Constants, q: Expr, f: Functions) -> Expr:
        pass


@final
class Harmonic(AbstractEvenProfile):
    r"""$U = \tfrac12 k z^2$: a trap, or with k < 0 a hill without end."""

    name = "harmonic"
    amplitude = Constant("stiffness", "k", Role.AMPLITUDE, "T-2")
    ratios = ((),)

    def of_square(self, c: Constants, q: Expr, f: Functions) -> Expr:
        return q / 2


@final
class Gaussian(AbstractEvenProfile):
    r"""$U = U_0 \exp(-z^2 / 2\sigma^2)$: the paper's barrier, eq. (1)."""

    name = "Gaussian"
    shapes = (WIDTH,)

    def of_square(self, c: Constants, q: Expr, f: Functions) -> Expr:
        return f.exp(-q / (2 * c[0] ** 2))


@final
class Lorentzian(AbstractEvenProfile):
    r"""$U = U_0 / (1 + z^2/s^2)$."""

    name = "Lorentzian"
    shapes = (CORE,)

    def of_square(self, c: Constants, q: Expr, f: Functions) -> Expr:
        return 1 / (1 + q / c[0] ** 2)


@final
class SquaredSech(AbstractProfile):
    r"""$U = U_0\,\mathrm{sech}^2(z/w)$, as the product of two logistics, times four."""

    name = "squared sech"
    shapes = (EDGE,)

    def value(self, c: Constants, z: Expr, f: Functions) -> Expr:
        turned = 2 * z / c[0]
        return 4 * f.logistic(turned) * f.logistic(-turned)


@final
class SoftCoulomb(AbstractEvenProfile):
    r"""$U = U_0 / \sqrt{1 + z^2/s^2}$: a charge that is not screened, with a core."""

    name = "soft Coulomb"
    shapes = (CORE,)

    def of_square(self, c: Constants, q: Expr, f: Functions) -> Expr:
        return 1 / f.root(1 + q / c[0] ** 2)


@final
class SoftLogarithm(AbstractEvenProfile):
    r"""$U = \tfrac12 A \log(1 + z^2/s^2)$: a line charge, or a vortex with a core."""

    name = "soft logarithm"
    amplitude = Constant("strength", "A", Role.AMPLITUDE, "L2 T-2")
    shapes = (CORE,)

    def of_square(self, c: Constants, q: Expr, f: Functions) -> Expr:
        return f.log(1 + q / c[0] ** 2) / 2


@final
class InversePower(AbstractEvenProfile):
    r"""$U = U_0 (1 + z^2/s^2)^{-n/2}$: $1/z^n$ beyond a soft core."""

    name = "inverse power"
    shapes = (CORE, EXPONENT)
    ratios = ((1.0, 1.0), (1.0, 3.0))
    limits = ("Gaussian", "Lorentzian", "soft Coulomb")

    def of_square(self, c: Constants, q: Expr, f: Functions) -> Expr:
        return f.exp(-c[1] * f.log(1 + q / c[0] ** 2) / 2)


@final
class Yukawa(AbstractEvenProfile):
    r"""$U = U_0\, s\, e^{-(\rho - s)/\lambda}/\rho$, $\rho = \sqrt{z^2 + s^2}$."""

    name = "Yukawa"
    shapes = (CORE, Constant("range", r"\lambda", Role.SCALE))
    ratios = ((1.0, 0.5), (1.0, 2.0))
    limits = ("Gaussian", "soft Coulomb")

    def of_square(self, c: Constants, q: Expr, f: Functions) -> Expr:
        distance = f.root(q + c[0] ** 2)
        return c[0] * f.exp(-(distance - c[0]) / c[1]) / distance


@final
class SoftDisc(AbstractEvenProfile):
    r"""$U = U_0 / (1 + e^{(\rho - R)/w})$: a disc, or a band, with a soft edge.

    $\rho = \sqrt{z^2 + w^2}$ keeps the force smooth at the centre.
    """

    name = "soft disc"
    shapes = (RADIUS, EDGE)
    ratios = ((1.0, 0.4),)
    limits = ("logistic wall",)

    def of_square(self, c: Constants, q: Expr, f: Functions) -> Expr:
        return f.logistic((c[0] - f.root(q + c[1] ** 2)) / c[1])


@final
class Ring(AbstractProfile):
    r"""$U = U_0 \exp(-(z - R)^2 / 2\sigma^2)$: a ridge at the distance R."""

    name = "ring"
    shapes = (RADIUS, WIDTH)
    ratios = ((0.7, 0.3), (1.0, 0.3), (1.4, 0.4))
    limits = ("Gaussian",)
    found_in = (DISTANCES,)

    def value(self, c: Constants, z: Expr, f: Functions) -> Expr:
        return Gaussian().value(c[1:], z - c[0], f)


@final
class CompactHill(AbstractEvenProfile):
    r"""$U = U_0 (1 - z^2/R^2)^n$ within R, and nothing beyond."""

    name = "compact hill"
    shapes = (RADIUS, EXPONENT)
    ratios = ((2.0, 2.0), (2.5, 3.0), (4.0, 6.0))
    limits = ("Gaussian",)

    def of_square(self, c: Constants, q: Expr, f: Functions) -> Expr:
        return f.positive_power(1 - q / c[0] ** 2, c[1])


@final
class SuperGaussian(AbstractEvenProfile):
    r"""$U = U_0 \exp(-(z^2 / 2\sigma^2)^m)$: flat, or with m < 1 pointed."""

    name = "super-Gaussian"
    shapes = (WIDTH, Constant("steepness", "m", Role.SCALE, "1"))
    ratios = ((1.0, 0.7), (1.0, 1.6))
    limits = ("Gaussian",)
    fitted = "plateau"
    fitted_in = (DISTANCES,)
    numbers = (SIZE, STEEPNESS)

    def of_square(self, c: Constants, q: Expr, f: Functions) -> Expr:
        return f.exp(-f.positive_power(q / (2 * c[0] ** 2), c[1]))


@final
class Hill(AbstractEvenProfile):
    r"""$U = U_0 (1 + \kappa z^2 / 2 s^2)^{-1/\kappa}$: a hill of any tail.

    Tails fall as a power where $\kappa$ is positive (a Lorentzian at one, a screened
    charge at two); at zero the hill is Gaussian, and below it ends at a finite
    distance.
    """

    name = "hill"
    shapes = (CORE, TAIL)
    found_in = ()
    fitted = "hill"
    fitted_in = (DISTANCES,)
    numbers = (SIZE, FORM)

    def of_square(self, c: Constants, q: Expr, f: Functions) -> Expr:
        return f.falling(q / (2 * c[0] ** 2), c[1])


@final
class Ridge(AbstractEvenProfile):
    r"""The profile of a `Hill` about a place of its own: in a fit, a ring."""

    name = "ridge"
    shapes = (CORE, TAIL)
    found_in = ()
    fitted = "ring"
    fitted_in = (DISTANCES, LINES)
    numbers = (
        PLACE._replace(name="radius", reach=1.0),
        SIZE,
        FORM._replace(starts=lambda _: np.zeros(1)),
    )

    def of_square(self, c: Constants, q: Expr, f: Functions) -> Expr:
        return Hill().of_square(c, q, f)


@final
class Step(AbstractProfile):
    r"""$U = U_0 / (1 + e^{-z/w})$: a wall; along a line alone."""

    name = "logistic wall"
    shapes = (EDGE,)
    ratios = ((0.5,),)
    found_in = (LINES,)
    fitted = "step"
    fitted_in = (DISTANCES, LINES)
    numbers = (PLACE, SIZE)

    def value(self, c: Constants, z: Expr, f: Functions) -> Expr:
        return f.logistic(z / c[0])


@final
class Channel(AbstractProfile):
    r"""$U = U_0 / (1 + e^{(a - z)/w}) + U_0 / (1 + e^{(a + z)/w})$: two equal walls."""

    name = "channel"
    shapes = (Constant("half_width", "a", Role.SCALE), EDGE)
    ratios = ((1.0, 0.2), (2.0, 0.3))
    limits = ("logistic wall",)
    found_in = (LINES,)
    fitted = "channel"
    fitted_in = (LINES,)
    numbers = (
        PLACE._replace(name="middle"),
        PLACE._replace(name="half width", starts=Span.halves),
        SIZE,
    )

    def value(self, c: Constants, z: Expr, f: Functions) -> Expr:
        return f.logistic((z - c[0]) / c[1]) + f.logistic((-z - c[0]) / c[1])


@final
class Wave(AbstractProfile):
    r"""$U = U_0 \cos(2\pi z / \lambda)$: stripes along a line."""

    name = "wave"
    shapes = (Constant("period", r"\lambda", Role.SCALE),)
    found_in = ()
    fitted = "wave"
    fitted_in = (LINES,)
    numbers = (PLACE, PERIOD)

    def value(self, c: Constants, z: Expr, f: Functions) -> Expr:
        return f.cos(2 * f.pi * z / c[0])


PROFILES: dict[str, AbstractProfile] = {
    cls.name: cls()
    for family in (AbstractProfile, AbstractEvenProfile)
    for cls in family.__subclasses__()
    if cls is not AbstractEvenProfile
}
"""All profiles by their names."""

FITTED: dict[str, AbstractProfile] = {
    profile.fitted: profile for profile in PROFILES.values() if profile.fitted
}
"""Profiles that terms of a fit may follow, by the words for them in tables."""
