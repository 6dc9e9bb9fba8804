r"""The functions and constants that formulas of forces are made of.

A formula is written once: it takes its functions from JAX or from SymPy. So the force
of a scenario, the term that is fitted, the law that is found and the formula that is
printed cannot disagree.
"""

import dataclasses
import enum
import functools
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from pinav.arguments import Scalar

Expr = Any
"""JAX arrays without axes, numbers, or expressions of SymPy."""

Constants = Sequence[Expr] | Float[Array, " constant"]
"""Values or symbols of the constants of a formula, in their order."""


class Functions(NamedTuple):
    """The functions that formulas are made of.

    Attributes:
        root: square root of a number that is not negative; of numbers its derivative
            is finite at zero, so that forces are finite at a centre.
        positive_power: a power of the first number where that is positive, else zero.
        logistic: 1/(1 + exp(-z)); of numbers no z overflows it.
        falling: `falling` of a square and a tail.
    """

    exp: Callable[[Expr], Expr]
    log: Callable[[Expr], Expr]
    cos: Callable[[Expr], Expr]
    sin: Callable[[Expr], Expr]
    root: Callable[[Expr], Expr]
    positive_power: Callable[[Expr, Expr], Expr]
    logistic: Callable[[Expr], Expr]
    falling: Callable[[Expr, Expr], Expr]
    pi: Expr


@functools.cache
def symbolic() -> Functions:
    """The functions of SymPy, which takes long to import."""
    import sympy

    return Functions(
        sympy.exp,
        sympy.log,
        sympy.cos,
        sympy.sin,
        sympy.sqrt,
        lambda base, exponent: sympy.Max(0, base) ** exponent,
        lambda z: 1 / (1 + sympy.exp(-z)),
        lambda square, tail: (1 + tail * square) ** (-1 / tail),
        sympy.pi,
    )


TINY = 1e-30
"""Squared distance [L²] below which the root is flat."""


def _root(square: Float[Array, ""]) -> Float[Array, ""]:
    return jnp.sqrt(square + TINY)


def _positive_power(base: Scalar, exponent: Scalar) -> Float[Array, ""]:
    is_positive = base > 0
    kept = jnp.where(is_positive, base, 1.0)  # no logarithm of zero in either branch
    return jnp.where(is_positive, jnp.exp(exponent * jnp.log(kept)), 0.0)


NEAR_GAUSSIAN = 1e-4
r"""$|\kappa|$ below which the logarithm is a series: its slope loses digits there."""


def falling(square: Scalar, tail: Scalar) -> Float[Array, ""]:
    r"""$(1 + \kappa q)^{-1/\kappa}$, which is $e^{-q}$ at $\kappa = 0$.

    Args:
        square: $q$, not negative.
        tail: $\kappa$.

    References:
        Tsallis, J. Stat. Phys. 52, 479 (1988), whose exponential this is.
    """
    is_near = jnp.abs(tail) < NEAR_GAUSSIAN
    curved = jnp.where(is_near, 1.0, tail)  # no division by zero in either branch
    bent = curved * square
    is_within = bent > -1
    power = jnp.log1p(jnp.where(is_within, bent, 0.0)) / curved
    series = square * (1 - tail * square * (0.5 - tail * square / 3))
    value = jnp.exp(-jnp.where(is_near, series, power))
    return jnp.where(is_near | is_within, value, 0.0)


NUMERIC = Functions(
    jnp.exp,
    jnp.log,
    jnp.cos,
    jnp.sin,
    _root,
    _positive_power,
    jax.nn.sigmoid,
    falling,
    jnp.pi,
)
"""The functions of JAX."""


class Role(enum.Enum):
    """The kind of a constant, against which its uncertainty is judged."""

    AMPLITUDE = "amplitude"
    POSITION = "position"
    SCALE = "scale"
    ANGLE = "angle"


@dataclasses.dataclass(frozen=True)
class Constant:
    """A constant of a formula.

    Attributes:
        name: in words, as `height`.
        role: amplitudes enter the force linearly, scales are positive.
        unit: its dimension, as `pinav.units.model_unit` takes it.
    """

    name: str
    symbol: str
    role: Role
    unit: str = "L"

    def with_index(self, index: int, count: int) -> "Constant":
        """The constant with an index, where several of its name stand together."""
        if count == 1:
            return self
        body, _, mark = self.symbol.partition("_")
        marks = ",".join(filter(None, (mark.strip("{}"), str(index))))
        symbol = f"{body}_{{{marks}}}"
        return dataclasses.replace(self, name=f"{self.name}_{index}", symbol=symbol)


def symbols(constants: Iterable[Constant]) -> tuple[Expr, ...]:
    """The constants as symbols of SymPy."""
    import sympy

    return tuple(
        sympy.Symbol(one.symbol, real=True, positive=one.role is Role.SCALE or None)
        for one in constants
    )
