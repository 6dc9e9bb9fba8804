"""Laws: formulas of a planar force with constants, and how they are printed."""

import abc
import dataclasses
import itertools
from collections.abc import Iterator
from typing import ClassVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Scalar, Vector
from pinav.errors import InputError
from pinav.forces import AbstractForce
from pinav.forces.formulas import (
    NUMERIC,
    Constant,
    Constants,
    Expr,
    Functions,
    Role,
    symbolic,
)


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

    @abc.abstractmethod
    def potential(self, c: Constants, x: Expr, y: Expr, f: Functions) -> Expr:
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
class Turned(AbstractLaw):
    """A law whose potential is taken as a stream function: its force is turned."""

    law: AbstractLaw
    name: str
    constants: tuple[Constant, ...] = dataclasses.field(init=False, repr=False)
    turns = True

    def __post_init__(self) -> None:
        constants = tuple(map(_of_rotation, self.law.constants))
        object.__setattr__(self, "constants", constants)

    def potential(self, c: Constants, x: Expr, y: Expr, f: Functions) -> Expr:
        return self.law.potential(c, x, y, f)

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
        numbered = tuple(_number(c, i, names.count(c.name)) for i, c in numbers)
        object.__setattr__(self, "name", " + ".join(t.name for t in self.terms))
        object.__setattr__(self, "constants", numbered)

    def potential(self, c: Constants, x: Expr, y: Expr, f: Functions) -> Expr:
        return potential_of(self, c, (x, y), f, turns=False)

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
    law: AbstractLaw,
    c: Constants,
    place: tuple[Expr, Expr],
    f: Functions,
    *,
    turns: bool,
) -> Expr:
    """The potential of the terms that have one, or the stream function of the rest."""
    parts = (t.potential(v, *place, f) for t, v in law.split(c) if t.turns is turns)
    return sum(parts)


class LawForce(AbstractForce):
    """The force of a law in the plane; its constants train.

    Raises:
        InputError: there are more or fewer values than constants.
    """

    law: AbstractLaw = eqx.field(static=True)
    constants: Float[Array, " constant"]

    def __check_init__(self) -> None:
        expected = (len(self.law.constants),)
        if np.shape(self.constants) != expected:
            raise InputError(
                f"LawForce.constants: {self.law.name} expects shape {expected}, got "
                f"{np.shape(self.constants)}"
            )

    def potential(self, t: Scalar, x: Float[Array, "2"]) -> Float[Array, ""]:
        """Potential energy per mass [L² T⁻²] of the conservative part."""
        return self._potential(x, turns=False)

    def _potential(self, x: Float[Array, "2"], *, turns: bool) -> Float[Array, ""]:
        place = x[0], x[1]
        value = potential_of(self.law, self.constants, place, NUMERIC, turns=turns)
        return jnp.zeros((), x.dtype) + value

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        along, across = jax.grad(lambda x: self._potential(x, turns=True))(x)
        turned = jnp.stack([across, -along])
        return turned - jax.grad(self.potential, argnums=1)(t, x)


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
    constants = {
        constant.name: sympy.Symbol(
            constant.symbol,
            real=True,
            positive=True if constant.role is Role.SCALE else None,
        )
        for constant in law.constants
    }
    values = tuple(constants.values())
    potential, stream = (
        sympy.sympify(potential_of(law, values, (x, y), symbolic(), turns=turns))
        for turns in (False, True)
    )
    force = (
        sympy.diff(stream, y) - sympy.diff(potential, x),
        -sympy.diff(stream, x) - sympy.diff(potential, y),
    )
    symbols = {"x": x, "y": y} | constants
    return LawExpressions(symbols, potential, stream, force)


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


def _number(constant: Constant, term: int, count: int) -> Constant:
    """The constant with the number of its term, where several share its name."""
    if count == 1:
        return constant
    body, _, index = constant.symbol.partition("_")
    inner = index.strip("{}")
    symbol = f"{body}_{{{inner},{term}}}" if inner else f"{body}_{{{term}}}"
    return dataclasses.replace(constant, name=f"{constant.name}_{term}", symbol=symbol)
