r"""Quantities that follow from a posterior, with their standard deviations.

The delta method: $\mathrm{var}\,q = \nabla q^\top \Sigma\, \nabla q$ about the best
parameters.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.errors import InputError
from pinav.fitting.engine.posterior import Estimate, Posterior
from pinav.forces import (
    AbstractForce,
    CholeskyTensor,
    TensorDrag,
    as_learned_force,
)


def derive(
    posterior: Posterior, quantity: Callable[[Any], Float[Array, " value"]]
) -> list[Estimate]:
    """Values of a function of the model, with their standard deviations.

    Args:
        posterior: of the model's parameters.
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
