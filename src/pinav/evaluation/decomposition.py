"""What makes up the acceleration along a trajectory."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from pinav.dynamics import Swimmer, with_dtype


class Decomposition(eqx.Module):
    """What makes up the acceleration along a trajectory.

    Attributes:
        times: times [T].
        terms: propulsion, environment and drag at each time [L T⁻²].
    """

    times: Float[np.ndarray, " time"]
    terms: dict[str, Float[np.ndarray, "time dim"]]


def decompose(
    swimmer: Swimmer,
    times: Float[np.ndarray, " time"],
    states: Float[np.ndarray, "time state"],
) -> Decomposition:
    """Split a(t) = propulsion + environment + drag along given states.

    References:
        PI-NAV paper, addendum 3 (structural interpretability).
    """
    exact = with_dtype(swimmer, jnp.float64)
    x, v = jnp.split(jnp.asarray(states), 2, axis=1)
    forces = {
        "propulsion": exact.propulsion,
        "environment": exact.environment,
        "drag": exact.drag,
    }
    ts = jnp.asarray(times)
    terms = {k: np.asarray(jax.vmap(f)(ts, x, v)) for k, f in forces.items()}
    return Decomposition(np.asarray(times), terms)
