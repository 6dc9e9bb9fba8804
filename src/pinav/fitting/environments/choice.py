"""The choice of a model: name, size of its network, constants learned with it."""

from operator import attrgetter
from typing import Any

import msgspec

from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.forces import as_learned_force

KnownSwimmer = Swimmer | OverdampedSwimmer
"""Physics whose environment alone is unknown."""

POSITION_NETWORKS = ("neural-potential", "neural-force", "ude")
"""Models whose network sees standardised positions."""

BLACK_BOX = "nn-only"
"""The network in place of all physics."""

MIXTURE = "kernel-mixture"
"""The model with a gradient and a rotational part."""

TIMED = "kernel-potential-time"
"""The model whose environment changes with time and has a prior."""

PROFILE = "kernel-profile"
"""The model whose force depends on some coordinates alone."""

CONSTANTS = {
    "damping": "drag.damping",
    "gain": "propulsion.gain",
    "drag": "drag.tensor",
}
"""Short names of constants of a swimmer, and where they stand."""


class ModelChoice(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The model that stands for the unknown, and the constants learned with it.

    Attributes:
        name: of `MODELS`.
        seed: of the network's initial weights.
        width: neurons of each hidden layer.
        depth: number of hidden layers.
        learn: constants of the swimmer that are learned too, by their names in
            `CONSTANTS` or by the path of a leaf, such as `propulsion.gain`.
    """

    name: str = "kernel-potential"
    seed: int = 0
    width: int = 32
    depth: int = 2
    learn: tuple[str, ...] = ()

    def paths(self) -> dict[str, str]:
        """The path of each learned constant, by the name that tables give it."""
        return {name: CONSTANTS.get(name, name) for name in self.learn}

    def constants(self, model: Any) -> tuple[Any, ...]:
        """The learned constants of a model."""
        return tuple(attrgetter(path)(model) for path in self.paths().values())

    def trainable(self, model: Any) -> Any:
        """The leaves of a model that a fit changes."""
        return (learned_part(model), *self.constants(model))


def learned_part(model: Any) -> Any:
    """The part of a model that trains unless more is asked for."""
    if not isinstance(model, KnownSwimmer):
        return model.parameters
    learned = as_learned_force(model.environment)
    return () if learned is None else learned.trainable
