"""What of a model is unknown: its weights, and the constants to be learned."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Bool, Float

from pinav.dynamics import Swimmer, with_dtype
from pinav.errors import InputError
from pinav.fitting.engine.multiple_shooting import ParametricModel, ravel_model
from pinav.forces import AbstractLearnedForce
from pinav.trajectories import Trajectories


def learned_environment(model: Any) -> AbstractLearnedForce | None:
    """The environment where it has weights; None where it is a parametric force."""
    environment = model.environment
    return environment if isinstance(environment, AbstractLearnedForce) else None


def unknowns(model, learn) -> tuple[ParametricModel, Float[jax.Array, " parameter"]]:
    """The model as a function of what is learned, if anything is, and its start."""
    exact = with_dtype(model, jnp.float64)
    if learn is None:
        nothing, known = eqx.partition(exact, lambda _: False)
        return ParametricModel(known, ravel_pytree(nothing)[1]), jnp.zeros(0)
    _check_selection(model, learn)
    return ravel_model(exact, _trainable(learn))


def _weights(model) -> tuple:
    """The leaves that have a Gaussian prior; none in a parametric environment."""
    environment = learned_environment(model)
    if environment is None:
        return ()
    parameters = environment.parameters
    return parameters if isinstance(parameters, tuple) else (parameters,)


def _trainable(learn):
    def select(model):
        constants = learn(model)
        several = constants if isinstance(constants, tuple | list) else (constants,)
        return *_weights(model), *several

    return select


def is_weight(free: ParametricModel, theta) -> Bool[np.ndarray, " parameter"]:
    """Which entries of the parameter vector are weights of the environment."""
    marks = free.unravel(jnp.zeros_like(theta))
    if jax.tree.leaves(_weights(marks)):
        marks = eqx.tree_at(
            _weights, marks, jax.tree.map(jnp.ones_like, _weights(marks))
        )
    return np.asarray(ravel_pytree(marks)[0]) > 0


def num_positions(model, trajectories: Trajectories) -> int:
    """How many channels are positions; what follows them are velocities.

    Raises:
        InputError: the trajectories have other channels than the model has states.
    """
    count = len(trajectories.channels)
    environment = learned_environment(model)
    dim = None if environment is None else environment.dim
    if isinstance(model, Swimmer):
        dim = count // 2 if dim is None else dim
        fits, expected = count == 2 * dim, f"{2 * dim} channels, positions and"
        expected += " velocities"
    else:
        dim = count if dim is None else dim
        fits, expected = count in (dim, 2 * dim), f"{dim} or {2 * dim} channels"
    if not fits:
        raise InputError(
            f"fit_bayes trajectories: expected {expected}, got "
            f"{', '.join(trajectories.channels)}"
        )
    return dim


def parameter_names(free: ParametricModel, theta) -> tuple[str, ...]:
    """A name for every entry of the parameter vector: the path of its leaf."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(free.unravel(theta))
    names = []
    for path, leaf in leaves:
        name = jax.tree_util.keystr(path).lstrip(".")
        indices = np.ndindex(*leaf.shape) if leaf.ndim else [None]
        names += [name if i is None else f"{name}{list(i)}" for i in indices]
    return tuple(names)


def check_learned(model, names, flat):
    """Of an environment with weights these alone are learned."""
    if learned_environment(model) is None:
        return
    for name in np.array(names)[flat]:
        if name.startswith("environment."):
            raise InputError(
                f"fit_bayes learn: {name} belongs to the environment, whose "
                "weights alone are learned; pick constants of other forces"
            )


def _check_selection(model, learn):
    leaves = jax.tree.leaves(_trainable(learn)(model))
    if not any(isinstance(x, float) or eqx.is_inexact_array(x) for x in leaves):
        raise InputError(
            f"fit_bayes learn: {type(model.environment).__name__} has no weights; "
            "make an environment by kernel_environment, or pick numbers to learn, "
            "such as learn=lambda m: m.environment"
        )
