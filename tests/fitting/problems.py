"""Data and sums of squares of which tests of fits know the answer."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.dynamics import AbstractDynamics, Adaptive
from pinav.fitting.evidence.quadratic import Quadratic
from pinav.forces import AbstractForce, ZeroForce
from pinav.trajectories import Trajectories

STATES = ("x", "y", "vx", "vy")


def follow(truth, starts, times):
    """Exact trajectories in the plane: a start and the times of each."""
    states = [
        np.asarray(Adaptive().solve(truth, jnp.asarray(y0), jnp.asarray(ts))[0])
        for y0, ts in zip(starts, times, strict=True)
    ]
    channels = STATES[: states[0].shape[1]]
    return Trajectories.from_arrays(list(times), states, channels=channels)


def observing(data, observed):
    """The same data, of which only those numbers are observed."""
    masks = [mask[:n] for mask, n in zip(observed, data.lengths, strict=True)]
    return Trajectories.from_arrays(
        [piece.times for piece in data],
        [np.where(own, p.states, np.nan) for own, p in zip(masks, data, strict=True)],
        channels=data.channels,
        observed=masks,
    )


def beginning(data, count):
    """The first samples of the first trajectory."""
    return Trajectories.from_arrays(
        data.times[0, :count], data.states[0, :count], channels=data.channels
    )


def in_a_trap(rng, times, shape, rate, diffusion):
    """Exact positions of Ornstein and Uhlenbeck, begun in their steady state."""
    spread = np.sqrt(diffusion / rate)
    path = [spread * rng.normal(size=shape)]
    for interval in np.diff(times):
        decay = np.exp(-rate * interval)
        kick = np.sqrt(1 - decay**2) * spread * rng.normal(size=shape)
        path.append(decay * path[-1] + kick)
    return np.array(path)


def quadratic_of(design, data, point=None):
    """The squares of a linear model's residuals, about a point or the origin."""
    point = np.zeros(design.shape[1]) if point is None else point
    residuals = design @ point - data
    return Quadratic(
        point=point,
        hessian=design.T @ design,
        gradient=design.T @ residuals,
        squares=float(residuals @ residuals),
        num_free=len(data),
        log_determinant=0.0,
    )


class Drifter(AbstractDynamics):
    """Without inertia: the force is the velocity, as is the constant drift."""

    drift: Float[Array, " dim"]
    environment: AbstractForce

    def __call__(self, t, y):
        return self.drift + self.environment(t, y, jnp.zeros_like(y))

    def with_environment(self, environment):
        return eqx.tree_at(lambda m: m.environment, self, environment)

    def without_environment(self):
        return self.with_environment(ZeroForce())
