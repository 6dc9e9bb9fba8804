"""The policy of a global plan: at every step the direction it asks for."""

import jax.numpy as jnp

from pinav.navigation.controllers import AbstractController
from pinav.navigation.plan import TimeToGo


class PlanPolicy(AbstractController[tuple[()]]):
    """Follow a global plan with the greatest thrust, from wherever the swimmer is.

    The quickest controller here, and the crudest: it looks one step of the plan ahead
    and knows nothing of delays.

    Attributes:
        plan: the time-to-go.
    """

    plan: TimeToGo

    def start(self, observation):
        return ()

    def __call__(self, observation, memory, *, key):
        previous = observation.pending[-1]
        step = jnp.asarray(self.plan.step, observation.state.dtype)
        share = self.plan.share(observation.time, observation.state, previous)
        return self.plan.terrain.drive.command(share, previous, step), memory
