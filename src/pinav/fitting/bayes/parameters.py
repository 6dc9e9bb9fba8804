r"""Parameters of a fit, and quantities that follow from their posterior.

The delta method: $\mathrm{var}\,q = \nabla q^\top \Sigma\, \nabla q$ about the best
parameters.
"""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PyTree

from pinav.dynamics import Swimmer, with_dtype
from pinav.errors import InputError
from pinav.fitting.engine.local_model import (
    ConstantPriors,
    ParametricModel,
    known_model,
    ravel_model,
    selected_entries,
    wide_priors,
)
from pinav.fitting.engine.posterior import Estimate, Posterior
from pinav.fitting.evidence.quadratic import Parameters
from pinav.forces import (
    AbstractForce,
    AbstractLearnedForce,
    CholeskyTensor,
    TensorDrag,
    as_learned_force,
)
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
    """Priors of constants that have one, and of the geometry of structured terms."""
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


def derive(
    posterior: Posterior, quantity: Callable[[Any], Float[Array, " value"]]
) -> list[Estimate]:
    """Values of a function of the model, with their standard deviations.

    Args:
        quantity: from the model to a vector of numbers, differentiable.
    """

    def of(theta: Float[Array, " parameter"]) -> Float[Array, " value"]:
        return quantity(posterior.free(theta))

    with jax.enable_x64(new_val=True):
        theta = jnp.asarray(posterior.mean)
        # compiled as one: each operation by itself would take longer
        values, slopes = map(np.asarray, _value_and_slopes(of, theta))
    variances = np.einsum("vp,pq,vq->v", slopes, posterior.covariance, slopes)
    deviations = np.sqrt(np.maximum(variances, 0.0))
    pairs = zip(values, deviations, strict=True)
    return [Estimate(float(value), float(sd)) for value, sd in pairs]


@eqx.filter_jit
def _value_and_slopes(
    of: Callable[[Array], Array], theta: Float[Array, " parameter"]
) -> tuple[Float[Array, " value"], Float[Array, "value parameter"]]:
    value = of(theta)
    slopes = jax.jacrev if len(value) < len(theta) else jax.jacfwd
    return value, slopes(of)(theta)


def principal_drags(posterior: Posterior) -> dict[str, Estimate]:
    """The smaller and the larger drag in the plane, and the direction of the smaller.

    Returns:
        `along` and `across` [T⁻¹] and `director`, the angle of the direction of least
        drag to the x axis [rad], between -pi/2 and pi/2. Where the drag is isotropic
        there is no direction, and its standard deviation is infinite.

    Raises:
        InputError: the drag is no `TensorDrag` of a `CholeskyTensor` in the plane.
    """
    drag = posterior.model.drag
    tensor = drag.tensor if isinstance(drag, TensorDrag) else None
    if not isinstance(tensor, CholeskyTensor) or tensor.log_diagonal.shape != (2,):
        raise InputError(
            "principal_drags: expected a planar TensorDrag of a CholeskyTensor, got "
            f"{type(tensor or drag).__name__}"
        )
    names = ("along", "across", "director")
    values = derive(posterior, lambda model: _principal(model.drag.tensor))
    found: dict[str, Estimate] = dict(zip(names, values, strict=True))
    if not np.isfinite(found["director"].sd):
        found["director"] = Estimate(found["director"].value, float("inf"))
    return found


def _principal(tensor: CholeskyTensor) -> Float[Array, "3"]:
    matrix = tensor.lower() @ tensor.lower().T
    middle = (matrix[0, 0] + matrix[1, 1]) / 2
    difference = (matrix[0, 0] - matrix[1, 1]) / 2
    shear = matrix[0, 1]
    radius = jnp.hypot(difference, shear)
    angle = jnp.arctan2(-shear, -difference) / 2  # of the smaller principal value
    return jnp.stack([middle - radius, middle + radius, angle])


def rotational_fraction(
    posterior: Posterior, points: Float[np.ndarray, "point 2"], time: float = 0.0
) -> Estimate:
    r"""Share of the rotational part in the squared force, over given points.

    $\sum |F_\psi|^2 / \sum (|F_U|^2 + |F_\psi|^2)$; over the whole plane the two parts
    are orthogonal and this is the share of the squared force itself.

    Args:
        posterior: of a model whose environment is a `KernelMixture`.
        points: where the force is compared [L], such as visited ground.
        time: at which the force acts [T].

    Raises:
        InputError: the environment is no mixture, or there are no points.
    """
    environment = posterior.model.environment
    learned = as_learned_force(environment)
    if learned is None or learned.helmholtz is None or not len(points):
        raise InputError(
            "rotational_fraction: expected a KernelMixture and one or more points, got "
            f"{type(environment).__name__} and {len(points)} points"
        )
    places = jnp.asarray(points)

    def fraction(model: Any) -> Float[Array, "1"]:
        parts = model.environment.helmholtz
        rotation = _total_square(parts.rotation, time, places)
        gradient = _total_square(parts.gradient, time, places)
        return jnp.stack([rotation / (rotation + gradient)])

    return derive(posterior, fraction)[0]


def _total_square(
    force: AbstractForce, time: float, places: Float[Array, "point 2"]
) -> Float[Array, ""]:
    forces = jax.vmap(lambda x: force(time, x, jnp.zeros_like(x)))(places)
    return jnp.sum(forces**2)
