"""How the drift of thermal motion hangs together with its diffusion."""

import equinox as eqx

from pinav.dynamics import OverdampedSwimmer
from pinav.fitting.langevin.observation import LearnedObservation
from pinav.forces import KernelTensor


class Relation(eqx.Module):
    """How drift and diffusion hang together, and what of them is known.

    Attributes:
        thermal_energy: $k_BT$ of Einstein's relation; None for a free drift.
        learn_diffusion: whether D is not known.
        observation: priors of exposure and error, where they are learned.
    """

    thermal_energy: float | None
    learn_diffusion: bool
    observation: LearnedObservation | None

    @property
    def einstein(self) -> bool:
        r"""Whether the drift is $\beta D F + \nabla\cdot D$."""
        return self.thermal_energy is not None

    def swimmer_in(
        self, swimmer: OverdampedSwimmer, diffusion: KernelTensor
    ) -> OverdampedSwimmer:
        """The swimmer with the mobility that belongs to the diffusion."""
        if self.thermal_energy is None:
            return swimmer
        mobility = diffusion.scale_by(1 / self.thermal_energy)
        return eqx.tree_at(
            lambda m: m.mobility,
            swimmer,
            mobility,
            is_leaf=lambda leaf: leaf is swimmer.mobility,
        )
