"""A model as a function of one vector of parameters, and what its entries are."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, PyTree

from pinav.arguments import on_device
from pinav.fitting.matching.trainable import Trainable, split_trainable


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

    def at(self, theta: Float[np.ndarray, " parameter"]) -> Any:
        """The same outside of compiled functions, without a program for each leaf."""
        shapes, tree = jax.tree.flatten(jax.eval_shape(self.unravel, theta))
        ends = np.cumsum([shape.size for shape in shapes])
        parts = np.split(np.asarray(theta), ends[:-1])
        leaves = [
            on_device(part.reshape(shape.shape))
            # of no parameters there is one empty part and no leaf
            for part, shape in zip(parts, shapes, strict=False)
        ]
        return eqx.combine(jax.tree.unflatten(tree, leaves), self.static)


def ravel_model(
    model: Any, trainable: Trainable
) -> tuple[ParametricModel, Float[Array, " parameter"]]:
    """The model as a function of the selected leaves, and their values, in float64.

    Raises:
        InputError: the selection holds no number that could be a parameter.
    """
    free, static = split_trainable(model, trainable, jnp.float64)
    _, unravel = eqx.filter_eval_shape(ravel_pytree, free)  # which compiles nothing
    theta = np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(free)])
    return ParametricModel(static, unravel), on_device(theta)


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
    shapes = _shapes(parametric, count)
    marks = jax.tree.map(lambda leaf: np.zeros(leaf.shape, bool), shapes)
    leaves = jax.tree.leaves(select(marks))
    if leaves:
        ones = [np.ones_like(leaf) for leaf in leaves]
        marks = eqx.tree_at(lambda m: jax.tree.leaves(select(m)), marks, ones)
    flat = [np.ravel(leaf) for leaf in jax.tree.leaves(marks)]
    return np.concatenate(flat) if flat else np.zeros(0, bool)


def parameter_names(parametric: ParametricModel, count: int) -> tuple[str, ...]:
    """A name for every entry of the parameter vector: the path of its leaf.

    Args:
        parametric: the model.
        count: length of the vector.
    """
    names = []
    leaves = jax.tree_util.tree_leaves_with_path(_shapes(parametric, count))
    for path, leaf in leaves:
        name = jax.tree_util.keystr(path).lstrip(".")
        indices = np.ndindex(*leaf.shape) if leaf.shape else [None]
        names += [name if i is None else f"{name}{list(i)}" for i in indices]
    return tuple(names)


def _shapes(parametric: ParametricModel, count: int) -> PyTree:
    """Shapes of the leaves that are parameters; nothing is computed."""
    return jax.eval_shape(parametric.unravel, jax.ShapeDtypeStruct((count,), float))


ModelOfParameters = Callable[[Float[Array, " parameter"]], Any]
"""A `ParametricModel`, or one that the commands of a trajectory drive besides."""
