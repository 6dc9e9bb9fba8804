"""Elementary functions of formulas, for numbers and for symbols.

A law is written once: its formulas take these functions, of JAX or of SymPy. So the
force that is fitted and the formula that is printed cannot disagree.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

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
