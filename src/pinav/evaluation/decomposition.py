"""What makes up the acceleration along a trajectory."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.arguments import on_device
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
    terms = _terms(exact, on_device(times), on_device(states))
    return Decomposition(np.asarray(times), jax.tree.map(np.asarray, terms))


@eqx.filter_jit
def _terms(
    swimmer: Swimmer,
    times: Float[Array, " time"],
    states: Float[Array, "time state"],
) -> dict[str, Float[Array, "time dim"]]:
    """One compiled program in place of one for each operation."""
    x, v = jnp.split(states, 2, axis=1)
    forces = {
        "propulsion": swimmer.propulsion,
        "environment": swimmer.environment,
        "drag": swimmer.drag,
    }
    return {name: jax.vmap(force)(times, x, v) for name, force in forces.items()}
