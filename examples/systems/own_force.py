"""A system with a force of one's own, named own_force.py:screened.

A force is a class with its numbers as fields; it returns what is added to the
acceleration. A fit learns whatever of these numbers it is asked for.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from pinav.dynamics import Swimmer
from pinav.forces import AbstractForce, ConstantForce, LinearDrag, ZeroForce
from pinav.systems import Observation, RingStarts, System


class Screened(AbstractForce):
    """Repulsion from a charged post, screened by the ions of the fluid.

    Attributes:
        strength: force near the post [L T⁻²].
        length: over which it is screened [L].
        center: of the post [L].
    """

    strength: float
    length: float
    center: Float[Array, " dim"]

    def __call__(self, t, x, v):
        offset = x - self.center
        distance = jnp.sqrt(offset @ offset + 0.25)
        return self.strength * jnp.exp(-distance / self.length) * offset / distance


def screened() -> System:
    """A swimmer with linear drag and a constant thrust near a charged post."""
    system = System(
        name="screened post",
        swimmer=Swimmer(
            propulsion=ConstantForce([0.0, 0.1]),
            drag=LinearDrag(0.36),
            environment=ZeroForce(),
        ),
        dim=2,
        environment=Screened(3.0, 2.0, jnp.array([5.0, 5.0])),
        observation=Observation(noise=0.02),
        rule=RingStarts(center=(5.0, 5.0), radius=7.0, spread=2.0, speeds=(2.5, 5.0)),
        times=jnp.linspace(0.0, 10.0, 101),
    )
    return system.with_starts(jax.random.key(0))
