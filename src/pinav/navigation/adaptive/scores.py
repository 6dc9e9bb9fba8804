"""Judges what a flight has learned, by the truth."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.navigation.adaptive.flight import Flight
from pinav.navigation.adaptive.steering import Adaptive
from pinav.navigation.control.simple import physics_only
from pinav.navigation.task.task import Task

NOMINAL = 1.96
"""Half width of a band of 95 %, in standard deviations."""


def true_force(
    task: Task, positions: Float[np.ndarray, "point 2"]
) -> Float[np.ndarray, "point 2"]:
    """What the environment adds to the rate of a swimmer at rest, at positions [L]."""
    physics, rest = physics_only(task.truth), jnp.zeros(len(task.start) - 2)

    def at(x: Float[Array, "2"]) -> Float[Array, "2"]:
        state, idle = jnp.concatenate([x, rest]), jnp.zeros(2)
        return (task.truth(0.0, state, idle) - physics(0.0, state, idle))[-2:]

    return np.asarray(jax.vmap(at)(jnp.asarray(positions)), float)


def score_force(flight: Flight, adaptive: Adaptive) -> tuple[float, float]:
    """Error and cover of the last belief along the true path.

    Returns:
        Root sum of squared errors of the force over that of the force, and the fraction
        of its components within their bands of 95 %.
    """
    path = flight.states[:, :2]
    truth = true_force(adaptive.task, path)
    mean, sd = flight.belief.force(path)
    error = float(np.linalg.norm(mean - truth) / np.linalg.norm(truth))
    return error, float(np.mean(np.abs(mean - truth) <= NOMINAL * sd))
