r"""Laws: formulas of a planar force over elementary functions, with constants.

The force is that of a potential and of a stream function, whose part turns.

A law is written once: its formulas take these functions, of JAX or of SymPy. So the
force that is fitted and the formula that is printed cannot disagree.
"""

import abc
import dataclasses
import enum
import functools
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import Scalar, Vector
from pinav.errors import InputError
from pinav.forces import AbstractForce

Expr = Any
"""What formulas are made of: JAX arrays without axes, numbers, or those of SymPy."""


class Functions(NamedTuple):
    """The functions that formulas are made of.

    Attributes:
        exp: exponential.
        log: natural logarithm.
        cos: cosine.
        sin: sine.
        root: square root of a number that is not negative; of numbers its derivative
            is finite at zero, so that forces are finite at a centre.
        positive_power: a power of the first number where that is positive, else zero.
        logistic: 1/(1 + exp(-z)); of numbers no z overflows it.
    """

    exp: Callable[[Expr], Expr]
    log: Callable[[Expr], Expr]
    cos: Callable[[Expr], Expr]
    sin: Callable[[Expr], Expr]
    root: Callable[[Expr], Expr]
    positive_power: Callable[[Expr, Expr], Expr]
    logistic: Callable[[Expr], Expr]


@functools.cache
def symbolic() -> Functions:
    """The functions of SymPy, which takes long to import."""
    import sympy

    def positive_power(base: Expr, exponent: Expr) -> Expr:
        return sympy.Max(0, base) ** exponent

    return Functions(
        sympy.exp,
        sympy.log,
        sympy.cos,
        sympy.sin,
        sympy.sqrt,
        positive_power,
        lambda z: 1 / (1 + sympy.exp(-z)),
    )


def _root(square: Float[Array, ""]) -> Float[Array, ""]:
    return jnp.sqrt(square + TINY)


def _positive_power(
    base: Float[Array, ""], exponent: Float[Array, ""]
) -> Float[Array, ""]:
    is_positive = base > 0
    kept = jnp.where(is_positive, base, 1.0)  # no logarithm of zero in either branch
    return jnp.where(is_positive, jnp.exp(exponent * jnp.log(kept)), 0.0)


TINY = 1e-30
"""Squared distance [L²] below which the root is flat."""

NUMERIC = Functions(
    jnp.exp,
    jnp.log,
    jnp.cos,
    jnp.sin,
    _root,
    _positive_power,
    jax.nn.sigmoid,
)
"""The functions of JAX."""


Constants = Sequence[Expr] | Float[Array, " constant"]
"""Values or symbols of the constants of a law, in their order."""

Components = tuple[Expr, Expr]
"""The two components of a force."""


class Role(enum.Enum):
    """What a constant is, and so against what its uncertainty is judged."""

    AMPLITUDE = "amplitude"
    POSITION = "position"
    SCALE = "scale"
    ANGLE = "angle"


@dataclasses.dataclass(frozen=True)
class Constant:
    """A constant of a law.

    Attributes:
        name: in words, as `height`.
        symbol: as it is written in LaTeX.
        role: amplitudes enter the force linearly, scales are positive.
        unit: dimension in length L and time T; "1" means dimensionless.
    """

    name: str
    symbol: str
    role: Role
    unit: str = "L"


@dataclasses.dataclass(frozen=True)
class Landscape:
    """What the starts of a fit need to know of a force field.

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
    r"""A family of forces $F = -\nabla U + (\partial_y\psi, -\partial_x\psi)$.

    $c$ stands for the constants, in their order, and `f` for the elementary functions,
    of JAX or of SymPy.

    Attributes:
        name: what tables call it.
        constants: its constants, in order.
    """

    name: str
    constants: tuple[Constant, ...]

    @abc.abstractmethod
    def potential(self, c: Constants, x: Expr, y: Expr, f: Functions) -> Expr:
        """Potential energy per mass U [L² T⁻²] of the conservative part."""

    @abc.abstractmethod
    def stream(self, c: Constants, x: Expr, y: Expr, f: Functions) -> Expr:
        """Stream function ψ [L² T⁻²] of the part that has no potential."""

    @abc.abstractmethod
    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        """Constants from which a fit may start, whatever their amplitudes."""

    def __add__(self, other: "AbstractLaw") -> "SumLaw":
        """The law of the sum of two forces."""
        return SumLaw((*terms_of(self), *terms_of(other)))

    def contains(self, other: "AbstractLaw") -> bool:
        """Whether the other law is this one with special values of its constants.

        Such a law explains data as well, whatever they are, with more constants.
        """
        return False

    def indices(self, role: Role) -> list[int]:
        """Where the constants of that role stand."""
        return [i for i, constant in enumerate(self.constants) if constant.role is role]


class AbstractPotential(AbstractLaw):
    """A conservative law: all of it has a potential."""

    def stream(self, c: Constants, x: Expr, y: Expr, f: Functions) -> Expr:
        return 0


class AbstractRotation(AbstractLaw):
    """A law without any potential."""

    def potential(self, c: Constants, x: Expr, y: Expr, f: Functions) -> Expr:
        return 0


@final
@dataclasses.dataclass(frozen=True)
class Turned(AbstractRotation):
    """A law whose potential is taken as a stream function: its force is turned.

    Attributes:
        law: a potential.
        name: what tables call it.
    """

    law: AbstractPotential
    name: str
    constants: tuple[Constant, ...] = dataclasses.field(init=False, repr=False)

    def __post_init__(self) -> None:
        constants = tuple(map(_of_rotation, self.law.constants))
        object.__setattr__(self, "constants", constants)

    def stream(self, c: Constants, x: Expr, y: Expr, f: Functions) -> Expr:
        return self.law.potential(c, x, y, f)

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        return self.law.shapes(landscape)

    def contains(self, other: AbstractLaw) -> bool:
        return isinstance(other, Turned) and self.law.contains(other.law)


@dataclasses.dataclass(frozen=True)
class SumLaw(AbstractLaw):
    """The sum of laws; where constants share a name they are numbered by their term.

    Attributes:
        terms: the laws that add up.
        name: their names.
        constants: theirs, one term after the other.
    """

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
        return sum(t.potential(values, x, y, f) for t, values in self.split(c))

    def stream(self, c: Constants, x: Expr, y: Expr, f: Functions) -> Expr:
        return sum(t.stream(values, x, y, f) for t, values in self.split(c))

    def shapes(self, landscape: Landscape) -> list[tuple[float, ...]]:
        """The first shape of every term; sums start from fits of their terms."""
        return [sum((term.shapes(landscape)[0] for term in self.terms), ())]

    def contains(self, other: AbstractLaw) -> bool:
        """Whether each term of the other law is one of this sum, or contained in one.

        Args:
            other: a law, or a sum of no more terms.
        """
        theirs = terms_of(other)
        return self != other and any(
            all(
                mine == term or mine.contains(term)
                for mine, term in zip(chosen, theirs, strict=True)
            )
            for chosen in itertools.permutations(self.terms, len(theirs))
        )

    def split(self, c: Constants) -> Iterator[tuple[AbstractLaw, Constants]]:
        """Each term with its constants."""
        start = 0
        for term in self.terms:
            end = start + len(term.constants)
            yield term, c[start:end]
            start = end


class LawForce(AbstractForce):
    """The force of a law with given constants; at home in the plane.

    Attributes:
        law: the formula; fixed.
        constants: the values of its constants, in order: what trains.

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
        value = self.law.potential(self.constants, x[0], x[1], NUMERIC)
        return jnp.zeros((), x.dtype) + value

    def stream(self, x: Float[Array, "2"]) -> Float[Array, ""]:
        """Stream function [L² T⁻²] of the part without a potential."""
        value = self.law.stream(self.constants, x[0], x[1], NUMERIC)
        return jnp.zeros((), x.dtype) + value

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        along, across = jax.grad(self.stream)(x)
        turned = jnp.stack([across, -along])
        return turned - jax.grad(self.potential, argnums=1)(t, x)


class LawExpressions(eqx.Module):
    """A law in SymPy.

    Attributes:
        symbols: x, y and the constants, by name.
        potential: of the conservative part.
        stream: stream function of the rest.
        force: the two components of the whole force.
    """

    symbols: dict[str, Expr]
    potential: Expr
    stream: Expr
    force: Components


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
    potential = sympy.sympify(law.potential(values, x, y, symbolic()))
    stream = sympy.sympify(law.stream(values, x, y, symbolic()))
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
