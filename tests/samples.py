"""Values of any class that files can hold, made from its annotations."""

import enum
import inspect
import typing
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import msgspec
import numpy as np

from pinav import codec
from pinav.analysis import ForceSample
from pinav.evaluation import Regions
from pinav.forces.law_library import GAUSSIAN
from pinav.forces.laws import AbstractLaw
from pinav.thermal.protocols import Piecewise

GIVEN = {
    AbstractLaw: GAUSSIAN,
    ForceSample: ForceSample(*np.zeros((2, 4, 2)), np.eye(8), 1.0),
    Regions: Regions(),
    Piecewise: Piecewise.constant((0.0, 1.0), [1.0], 1.0),
}
"""Values of classes whose fields must agree."""


def sample(cls: type, *, whole: bool = False, **fields: Any) -> Any:
    """A record with some fields as they are given.

    Args:
        cls: class of the record.
        whole: also fill fields that have a default, options and collections.
        **fields: given values; others are zeros, ones, the letter a, or nothing.
    """
    hints, defaults = codec._hints(cls), codec._fields(cls)
    parts = {
        name: sample_of(hint, whole=whole)
        for name, hint in hints.items()
        if name not in fields and (whole or defaults[name] is inspect.Parameter.empty)
    }
    return cls(**(parts | fields))


def stand_in(cls: type, **fields: Any) -> Any:
    """An instance that has but the fields that a function asks for."""
    made = object.__new__(cls)
    for name, value in fields.items():
        object.__setattr__(made, name, value)
    return made


def sample_of(hint: Any, *, whole: bool = False) -> Any:
    """A value of an annotation; two for each axis of an array."""
    if type(None) in typing.get_args(hint) and not whole:
        return None
    hint = codec._of_option(hint)
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if hint in GIVEN:
        return GIVEN[hint]
    if hint in (np.ndarray, Any):
        return np.zeros(2) if hint is np.ndarray else "a"
    if hasattr(hint, "dim_str"):
        sizes = [int(d) if d.isdigit() else 2 for d in hint.dim_str.split()]
        kinds = [d for d in ("float64", "int64", "bool") if d in hint.dtypes]
        array = np.zeros(sizes, kinds[0] if kinds else hint.dtypes[0])
        return jnp.asarray(array) if hint.array_type is jax.Array else array
    if origin is list or Ellipsis in arguments:
        return (origin or list)([sample_of(arguments[0], whole=whole)] * whole)
    if origin is tuple:
        return tuple(sample_of(one, whole=whole) for one in arguments)
    if origin in (dict, Mapping):
        return {"a": sample_of(arguments[1], whole=whole)} if whole else {}
    if issubclass(hint, enum.Enum):
        return next(iter(hint))
    if issubclass(hint, bool | int | float | str):
        return {bool: False, int: 1, float: 1.0, str: "a"}[hint]
    if issubclass(hint, msgspec.Struct):
        return hint()
    members = codec.members(hint)
    return sample(next(iter(members.values())) if members else hint, whole=whole)
