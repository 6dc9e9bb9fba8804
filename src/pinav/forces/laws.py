r"""Laws: formulas of a force with constants, and how they are printed.

Most are a profile of the coordinates of a geometry (`ProfileLaw`). With
numbers for its constants a law is a `LawForce`.
"""

import abc
import dataclasses
import itertools
from collections.abc import Iterator
from typing import ClassVar, final

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.forces.formulas import (
    Constant,
    Constants,
    Expr,
    Functions,
    Role,
    symbolic,
    symbols,
)
from pinav.forces.geometries import (
    AbstractGeometry,
    Landscape,
    Line,
    Place,
)
from pinav.forces.profiles import LINES, AbstractProfile, Harmonic


class AbstractLaw(abc.ABC):
    r"""A family of forces $-\nabla U$, or such forces turned by a right angle.

    $c$ stands for the constants, in their order, and `f` for the elementary functions,
    of JAX or of SymPy.

    Attributes:
        turns: True if $U$ is a stream function.
    """

    name: str
    constants: tuple[Constant, ...]
    turns: ClassVar[bool] = False

    @property
    def is_straight(self) -> bool:
        """True if it is a function of the place along a line."""
        return False

    @abc.abstractmethod
    def potential(self, c: Constants, x: Place, f: Functions) -> Expr:
        """Potential energy per mass, or the stream function [L² T⁻²]."""

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        """Constants from which a fit may start, whatever their amplitudes.

        Those of a law that has a centre, and amplitudes before it.
        """
        ones = (1.0,) * (len(self.constants) - 2)
        return [(*ones, *center) for center in landscape.centers]

    def __add__(self, other: "AbstractLaw") -> "SumLaw":
        """The law of the sum of two forces."""
        return SumLaw((*terms_of(self), *terms_of(other)))

    def contains(self, other: "AbstractLaw") -> bool:
        """True if the other law is this one with special values of its constants.

        Such a law explains data as well, whatever they are, with more constants.
        """
        return False

    def split(self, c: Constants) -> Iterator[tuple["AbstractLaw", Constants]]:
        """Each term with its constants."""
        yield self, c

    def indices(self, role: Role) -> list[int]:
        """Indices of the constants that have a role."""
        return [i for i, constant in enumerate(self.constants) if constant.role is role]


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
        object.__setattr__(self, "name", self.geometry.name(profile))
        object.__setattr__(self, "constants", constants)

    @property
    def is_straight(self) -> bool:
        return self.geometry.family == LINES

    def potential(self, c: Constants, x: Place, f: Functions) -> Expr:
        places = self.geometry.coordinates(c[1:], x, f)
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


@final
@dataclasses.dataclass(frozen=True)
class Turned(AbstractLaw):
    """A law whose potential is taken as a stream function: its force is turned."""

    law: AbstractLaw
    name: str = dataclasses.field(init=False, repr=False)
    constants: tuple[Constant, ...] = dataclasses.field(init=False, repr=False)
    turns = True

    def __post_init__(self) -> None:
        name, constants = self.law.name, tuple(map(_of_rotation, self.law.constants))
        if self.law == ProfileLaw(Harmonic(), Line()):
            name = "shear"
        else:
            name = f"shear, {name}" if self.law.is_straight else f"{name} swirl"
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "constants", constants)

    def potential(self, c: Constants, x: Place, f: Functions) -> Expr:
        return self.law.potential(c, x, f)

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        return self.law.shapes(landscape)

    def contains(self, other: AbstractLaw) -> bool:
        return isinstance(other, Turned) and self.law.contains(other.law)


@final
@dataclasses.dataclass(frozen=True)
class SumLaw(AbstractLaw):
    """The sum of laws; where constants share a name they are numbered by their term."""

    terms: tuple[AbstractLaw, ...]
    name: str = dataclasses.field(init=False, repr=False)
    constants: tuple[Constant, ...] = dataclasses.field(init=False, repr=False)

    def __post_init__(self) -> None:
        numbers = [(i, c) for i, t in enumerate(self.terms, 1) for c in t.constants]
        names = [constant.name for _, constant in numbers]
        constants = tuple(c.with_index(i, names.count(c.name)) for i, c in numbers)
        object.__setattr__(self, "name", " + ".join(t.name for t in self.terms))
        object.__setattr__(self, "constants", constants)

    def potential(self, c: Constants, x: Place, f: Functions) -> Expr:
        return potential_of(self, c, x, f, turns=False)

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        """The first shape of every term; sums start from fits of their terms."""
        return [sum((term.shapes(landscape)[0] for term in self.terms), ())]

    def contains(self, other: AbstractLaw) -> bool:
        """True if each term of the other law is one of this sum, or in one."""
        theirs = terms_of(other)
        return self != other and any(
            all(
                mine == term or mine.contains(term)
                for mine, term in zip(chosen, theirs, strict=True)
            )
            for chosen in itertools.permutations(self.terms, len(theirs))
        )

    def split(self, c: Constants) -> Iterator[tuple[AbstractLaw, Constants]]:
        start = 0
        for term in self.terms:
            end = start + len(term.constants)
            yield term, c[start:end]
            start = end


def potential_of(
    law: AbstractLaw, c: Constants, x: Place, f: Functions, *, turns: bool
) -> Expr:
    """The potential of the terms that have one, or the stream function of the rest."""
    parts = (t.potential(v, x, f) for t, v in law.split(c) if t.turns is turns)
    return sum(parts)


class LawExpressions(eqx.Module):
    """A law in SymPy: x, y and the constants by name, its two functions, its force."""

    symbols: dict[str, Expr]
    potential: Expr
    stream: Expr
    force: tuple[Expr, Expr]


def expressions(law: AbstractLaw) -> LawExpressions:
    """The formulas of a law as SymPy expressions, symbols for its constants."""
    import sympy

    x, y = sympy.symbols("x y", real=True)
    values = symbols(law.constants)
    potential, stream = (
        sympy.sympify(potential_of(law, values, (x, y), symbolic(), turns=turns))
        for turns in (False, True)
    )
    force = (
        sympy.diff(stream, y) - sympy.diff(potential, x),
        -sympy.diff(stream, x) - sympy.diff(potential, y),
    )
    names = ("x", "y", *(constant.name for constant in law.constants))
    named = dict(zip(names, (x, y, *values), strict=True))
    return LawExpressions(named, potential, stream, force)


def latex(law: AbstractLaw) -> str:
    """The law in LaTeX, symbols for its constants; without dollar signs."""
    import sympy

    formulas = expressions(law)
    lines = []
    if formulas.potential != 0:
        lines.append(f"U = {sympy.latex(formulas.potential)}")
    if formulas.stream != 0:
        lines.append(rf"\psi = {sympy.latex(formulas.stream)}")
    return r",\quad ".join(lines) or "F = 0"


def sympy_text(law: AbstractLaw, constants: Float[np.ndarray, " constant"]) -> str:
    """Both components of the force with numbers, as SymPy prints and parses them."""
    import sympy

    formulas = expressions(law)
    names = [constant.name for constant in law.constants]
    values = {
        formulas.symbols[name]: sympy.Float(float(value), 8)
        for name, value in zip(names, constants, strict=True)
    }
    return str(tuple(part.subs(values) for part in formulas.force))


def _of_rotation(constant: Constant) -> Constant:
    """The constant of a potential, as that of a stream function is called."""
    words = {"height": ("strength", "S"), "stiffness": ("rate", r"\gamma")}
    name, symbol = words.get(constant.name, (constant.name, constant.symbol))
    return dataclasses.replace(constant, name=name, symbol=symbol)


def terms_of(law: AbstractLaw) -> tuple[AbstractLaw, ...]:
    """The laws that a law is the sum of; itself where it is no sum."""
    return law.terms if isinstance(law, SumLaw) else (law,)
