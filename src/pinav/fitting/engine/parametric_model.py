"""A model as a function of one vector of parameters, and what its entries are."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, PyTree

from pinav.fitting.matching.fit import Trainable, split_trainable


class ParametricModel(eqx.Module):
    """A model as a function of the vector of its parameters.

    Attributes:
        static: the model without the leaves that are parameters.
        unravel: from the vector to those leaves.
    """

    static: PyTree
    unravel: Callable[[Float[Array, " parameter"]], PyTree] = eqx.field(static=True)

    def __call__(self, theta: Float[Array, " parameter"]) -> Any:
        """The model with these parameters."""
        return eqx.combine(self.unravel(theta), self.static)


def ravel_model(
    model: Any, trainable: Trainable
) -> tuple[ParametricModel, Float[Array, " parameter"]]:
    """The model as a function of the selected leaves, and their values, in float64.

    Raises:
        InputError: the selection holds no number that could be a parameter.
    """
    free, static = split_trainable(model, trainable, jnp.float64)
    theta, unravel = ravel_pytree(free)
    return ParametricModel(static, unravel), theta


def known_model(model: Any) -> ParametricModel:
    """A model without parameters."""
    nothing, known = eqx.partition(model, lambda _: False)
    return ParametricModel(known, ravel_pytree(nothing)[1])


def selected_entries(
    parametric: ParametricModel, count: int, select: Callable[[Any], PyTree]
) -> Bool[np.ndarray, " parameter"]:
    """Which entries of the parameter vector belong to a selection of leaves.

    Args:
        parametric: the model.
        count: length of the vector.
        select: picks leaves of the model.
    """
    marks = parametric.unravel(jnp.zeros(count))
    leaves = jax.tree.leaves(select(marks))
    if leaves:
        ones = [jnp.ones_like(leaf) for leaf in leaves]
        marks = eqx.tree_at(lambda m: jax.tree.leaves(select(m)), marks, ones)
    return np.asarray(ravel_pytree(marks)[0]) > 0


def parameter_names(parametric: ParametricModel, count: int) -> tuple[str, ...]:
    """A name for every entry of the parameter vector: the path of its leaf.

    Args:
        parametric: the model.
        count: length of the vector.
    """
    tree = parametric.unravel(jnp.zeros(count))
    names = []
    for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]:
        name = jax.tree_util.keystr(path).lstrip(".")
        indices = np.ndindex(*leaf.shape) if leaf.ndim else [None]
        names += [name if i is None else f"{name}{list(i)}" for i in indices]
    return tuple(names)


ModelOfParameters = Callable[[Float[Array, " parameter"]], Any]
"""A `ParametricModel`, or one that the commands of a trajectory drive besides."""
