"""Parameters of a fit: the weights of the environment, and constants to learn."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, PyTree

from pinav.dynamics import Swimmer, with_dtype
from pinav.errors import InputError
from pinav.fitting.engine.constant_priors import ConstantPriors, wide_priors
from pinav.fitting.engine.parametric_model import (
    ParametricModel,
    known_model,
    ravel_model,
    selected_entries,
)
from pinav.fitting.evidence.quadratic import Parameters
from pinav.forces import AbstractLearnedForce, as_learned_force
from pinav.systems.priors import Flat, FreeNumber
from pinav.trajectories import Trajectories


def learned_environment(model: Any) -> AbstractLearnedForce | None:
    """The environment where it has weights; None where it is a parametric force."""
    return as_learned_force(model.environment)


Learn = Callable[[Any], PyTree] | Sequence[FreeNumber] | None
"""Constants to learn: a function that picks them, or numbers with their priors; None
where all of the model is known."""


def parametrise(
    model: Any, learn: Learn
) -> tuple[ParametricModel, Float[jax.Array, " parameter"]]:
    """The model as a function of what is learned, if anything is, and its start."""
    exact = with_dtype(model, jnp.float64)
    if learn is None:
        return known_model(exact), jnp.zeros(0)

    def select(model: Any) -> tuple:
        constants = constant_leaves(model, learn)
        return *weight_leaves(model), *geometry_leaves(model), *constants

    leaves = jax.tree.leaves(select(model))
    if not any(isinstance(x, float) or eqx.is_inexact_array(x) for x in leaves):
        raise InputError(
            f"fit_bayes learn: {type(model.environment).__name__} has no weights; "
            "make an environment by kernel_environment, or pick numbers to learn, "
            "such as learn=lambda m: m.environment"
        )
    return ravel_model(exact, select)


def weight_leaves(model: Any) -> tuple:
    """The leaves that have a Gaussian prior; none in a parametric environment."""
    environment = learned_environment(model)
    if environment is None:
        return ()
    parameters = environment.parameters
    return parameters if isinstance(parameters, tuple) else (parameters,)


def geometry_leaves(model: Any) -> tuple:
    """Leaves of the environment that shape it, and have no part in its weights."""
    environment = learned_environment(model)
    return () if environment is None else environment.geometry


def constant_leaves(model: Any, learn: Learn) -> tuple:
    """The constants to learn; a learned environment among them adds nothing."""
    if learn is None:
        return ()
    if not callable(learn):
        return tuple(number.pick(model) for number in learn)
    picked = learn(model)
    parts = picked if isinstance(picked, tuple | list) else (picked,)
    if learned_environment(model) is None:
        return tuple(parts)
    return tuple(part for part in parts if part is not model.environment)


def constant_priors(
    model: Any, parametric: ParametricModel, theta: Parameters, learn: Learn
) -> ConstantPriors:
    """The priors of constants that have one, and of the geometry of structured terms.

    Args:
        model: at which a fit begins.
        parametric: the model as a function of its parameters.
        theta: the parameters at which a fit begins.
        learn: the constants.
    """
    force = learned_environment(model)
    scales = () if force is None else force.geometry_scales
    shaping = wide_priors(parametric, theta, geometry_leaves, scales)
    if learn is None or callable(learn):
        return shaping
    pairs = [
        (int(entry), number.prior)
        for number in learn
        if not isinstance(number.prior, Flat)
        for entry in np.flatnonzero(
            selected_entries(parametric, len(theta), number.pick)
        )
    ]
    return ConstantPriors(
        (*shaping.entries, *(entry for entry, _ in pairs)),
        (*shaping.priors, *(prior for _, prior in pairs)),
    )


def num_positions(model: Any, trajectories: Trajectories) -> int:
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


def check_learned(
    model: Any, names: tuple[str, ...], flat: Bool[np.ndarray, " parameter"]
) -> None:
    """Of an environment with weights these and its geometry alone are learned.

    Args:
        model: what is fitted.
        names: of all parameters.
        flat: those that are neither weights nor geometry.
    """
    if learned_environment(model) is None:
        return
    for name in np.array(names)[flat]:
        if name.startswith("environment."):
            raise InputError(
                f"fit_bayes learn: {name} belongs to the environment, whose "
                "weights alone are learned; pick constants of other forces"
            )
