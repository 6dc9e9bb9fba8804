"""What a fit minimises."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from pinav.arguments import on_device
from pinav.dynamics import AbstractDynamics, AbstractSolver, FixedStep
from pinav.errors import InputError
from pinav.trajectories import Trajectories


class Observations(eqx.Module):
    """Trajectories on the device, in the precision of the fit.

    Attributes:
        times: sample times [T]; padding repeats the last one.
        states: observed states; what was not observed is zero.
        observed: which entries of `states` are observations.
    """

    times: Float[Array, "trajectory time"]
    states: Float[Array, "trajectory time state"]
    observed: Bool[Array, "trajectory time state"]

    @classmethod
    def of(cls, trajectories: Trajectories, dtype: type) -> "Observations":
        """Observations of `trajectories` in the floating-point type `dtype`."""
        return cls(
            jnp.asarray(trajectories.times, dtype),
            jnp.asarray(trajectories.states, dtype),
            on_device(trajectories.observed),
        )


class AbstractObjective(eqx.Module):
    """A number that says how badly a model explains observations."""

    @abc.abstractmethod
    def __call__(
        self, model: AbstractDynamics, observations: Observations
    ) -> Float[Array, ""]:
        """Loss of `model`; smaller is better, not finite means diverged."""

    @abc.abstractmethod
    def check(self, trajectories: Trajectories) -> None:
        """Raise `InputError` where these trajectories cannot be used."""


class TrajectoryLoss(AbstractObjective):
    r"""Sum of squares $\sum_k |\hat u(t_k) - u(t_k)|^2$ over one rollout each.

    Every trajectory is rolled out from its first observed state; entries that were
    not observed do not count.

    Attributes:
        solver: how the rollout is integrated and its gradient taken.

    Raises:
        InputError: the first sample of a trajectory is not fully observed.

    References:
        PI-NAV paper, eq. (3).
    """

    solver: AbstractSolver = FixedStep()

    def __call__(
        self, model: AbstractDynamics, observations: Observations
    ) -> Float[Array, ""]:
        def residuals(
            times: Float[Array, " time"],
            states: Float[Array, "time state"],
            observed: Bool[Array, "time state"],
        ) -> Float[Array, "time state"]:
            ys, _ = self.solver.solve(model, states[0], times)
            return jnp.where(observed, ys - states, 0.0)

        per_trajectory = jax.vmap(residuals)(
            observations.times, observations.states, observations.observed
        )
        return jnp.sum(per_trajectory**2)

    def check(self, trajectories: Trajectories) -> None:
        for index, first in enumerate(trajectories.observed[:, 0]):
            if not first.all():
                raise InputError(
                    f"trajectory {index}: its first sample must be fully observed, "
                    "because the rollout starts there; drop the samples before it"
                )
