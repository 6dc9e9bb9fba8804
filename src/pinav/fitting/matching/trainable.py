"""Which numbers of a model are trained, and the model without them."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import PyTree

from pinav.errors import InputError

Trainable = Callable[[Any], PyTree]
"""Picks a subtree of a model, or a tuple of subtrees."""


def split_trainable(
    model: Any, trainable: Trainable, dtype: type
) -> tuple[PyTree, PyTree]:
    """The model as (leaves that train, everything else), to be recombined.

    Args:
        model: the model.
        trainable: picks a subtree or a tuple of subtrees; their inexact arrays and
            Python floats train.
        dtype: floating-point type of the leaves that train.

    Raises:
        InputError: the selection holds no number that could train.
    """

    def as_array(leaf: Any) -> Any:
        return jnp.asarray(leaf, dtype) if _is_number(leaf) else leaf

    def subtrees(model: Any) -> list[PyTree]:
        return _without_nesting(trainable(model))

    chosen = jax.tree.map(as_array, subtrees(model))
    model = eqx.tree_at(subtrees, model, chosen)
    spec = jax.tree.map(lambda _: False, model)
    spec = eqx.tree_at(subtrees, spec, jax.tree.map(eqx.is_inexact_array, chosen))
    if not any(jax.tree.leaves(spec)):
        raise InputError(
            "fit trainable: the selection holds no floating-point array or number; "
            "pick leaves of the model, such as lambda m: m.environment"
        )
    return eqx.partition(model, spec)


def _without_nesting(selection: PyTree) -> list[PyTree]:
    """Subtrees of nested tuples in one list, as `eqx.tree_at` needs them."""
    return jax.tree.leaves(selection, is_leaf=lambda s: not isinstance(s, tuple | list))


def _is_number(leaf: Any) -> bool:
    return isinstance(leaf, float) or eqx.is_inexact_array(leaf)
