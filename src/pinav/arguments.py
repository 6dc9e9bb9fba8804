"""Checks and conversions of arguments that several packages share."""

import dataclasses
import re
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from pinav.errors import InputError
from pinav.settings import POSITIVE, Range
from pinav.units import powers_of

Scalar = float | int | Float[Array, ""]
"""One real number: plain, NumPy's float64, or a JAX array without axes."""

Vector = Float[Array, " dim"]
"""A vector of the space: a position, a velocity, a force."""

Planar = Float[Array, "2"]
"""A vector of the plane, likewise."""

State = Float[Array, " state"]
"""State y of a swimmer: its position, and its velocity where it has inertia."""


def on_device(values: ArrayLike) -> Array:
    """An array for JAX with the numbers of numpy's, outside of compiled functions.

    With its type stated it is copied; without, JAX compiles a program for each shape.
    """
    if isinstance(values, jax.Array):
        return values
    numbers = np.asarray(values)
    return jnp.asarray(numbers, jax.dtypes.canonicalize_dtype(numbers.dtype))


def real_array(values: ArrayLike) -> Array:
    """The same as an array of real numbers, also where whole ones were given."""
    array = jnp.asarray(values)
    is_real = jnp.issubdtype(array.dtype, jnp.inexact)
    return array if is_real else array.astype(float)


def point(name: str, dim: int | None = None) -> Callable[[Any], Vector]:
    """Converter of a field that takes a point as list, tuple or array.

    It raises `InputError`, which calls the field `name`, where that is no point of
    `dim` components, or of any number unless given.
    """

    def convert(value: Any) -> Vector:
        shape = np.shape(value)
        if len(shape) != 1 or (dim is not None and shape != (dim,)):
            expected = "(dim,)" if dim is None else f"({dim},)"
            raise InputError(
                f"{name}: expected a point of shape {expected}, got {shape}"
            )
        if isinstance(value, jax.Array):
            return real_array(value)
        try:
            return jnp.asarray(value, float)
        except (TypeError, ValueError) as error:
            raise InputError(f"{name}: expected numbers, got {value!r}") from error

    return convert


def refuse_text(module: eqx.Module) -> None:
    """Raise `InputError` where a field of a module holds text in place of a number."""
    for field in dataclasses.fields(module):
        value = getattr(module, field.name)
        if isinstance(value, str) and field.type is not str:
            name = f"{type(module).__name__}.{field.name}"
            raise InputError(f"{name}: expected a number, got {value!r}")


def check_range(module: Any, allowed: Range, *names: str) -> None:
    """Raise `InputError` where a field of a module is a plain number outside."""
    for name in names:
        value = getattr(module, name)
        if isinstance(value, float | int):
            allowed.check(f"{type(module).__name__}.{name}", value)


def check_positive(module: eqx.Module, *names: str) -> None:
    """Raise `InputError` where a field of a module is a number <= 0.

    Unlike a setting it may be infinite, as a limit that is none.
    """
    for name in names:
        value = getattr(module, name)
        if isinstance(value, float | int) and not value > 0:
            POSITIVE.check(f"{type(module).__name__}.{name}", value)


def dimension(text: str | Callable[[Any], tuple[str, ...]]) -> dict[str, Any]:
    """The metadata of a field that holds a quantity of a dimension, such as "L2 T-1".

    What is learned is printed in a unit of this dimension: `pinav.units.unit_of`.

    Args:
        text: powers of L (length), T (time) and F (force), "1" of a plain number; or a
            function of the module, of those of each of several numbers.

    Raises:
        InputError: it is none.
    """
    if isinstance(text, str):
        powers_of(text)
    return {"dimension": text}


def dimension_of(part: Any, path: str) -> str:
    """The dimension of a number of a module.

    A number without one, such as the value of a tensor, has that of the field that
    holds its module; "?" where none does.

    Args:
        part: a module, or its class.
        path: from the module to the number, such as `terms[0].height`.
    """
    stated: Any = "?"
    for place, name in STEPS.findall(path):
        if name:
            kind = part if isinstance(part, type) else type(part)
            fields = getattr(kind, "__dataclass_fields__", {})
            if name not in fields:
                return stated
            stated = fields[name].metadata.get("dimension", stated)
            stated = stated(part) if callable(stated) else stated
            part = getattr(part, name, None)
        else:
            stated = stated if isinstance(stated, str) else stated[int(place)]
            part = part[int(place)] if isinstance(part, tuple | list) else None
    return stated if isinstance(stated, str) else "?"


STEPS = re.compile(r"\[(\d+)\]|([^.\[\]]+)")
"""Steps of a path: a place in a tuple, in brackets, or the name of a field."""
