"""The choice of a model, and the numbers that an untrained one takes from data."""

import dataclasses
from collections.abc import Callable
from functools import partial
from operator import attrgetter
from typing import Any

import msgspec
import numpy as np

from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.fitting.environments.gradient_matching import kernels_of
from pinav.fitting.environments.kernels import changing_environment, kernel_environment
from pinav.fitting.environments.rates import (
    MOST_SAMPLES,
    force_region,
    forces_beside_drag,
    observed_rates,
    residual_forces,
    thin_rates,
)
from pinav.forces import (
    AbstractLearnedForce,
    KernelForce,
    KernelMixture,
    KernelPotential,
    KernelTensor,
    as_learned_force,
)
from pinav.trajectories import Trajectories

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


@dataclasses.dataclass(frozen=True)
class DataSummary:
    """The part of the data that an untrained model is built from.

    Attributes:
        dim: number of coordinates.
        mean: of each observed state, then of time.
        std: standard deviation of each of them; 1 where it is zero.
        environment: what is learned of the force, around the data; None of a network.
        mobility: where it is learned.
    """

    dim: int
    mean: tuple[float, ...]
    std: tuple[float, ...]
    environment: AbstractLearnedForce | None = None
    mobility: KernelTensor | None = None

    def of_fit(self, model: Any) -> "DataSummary":
        """The summary of a fitted model, whose kernels may be finer than at first."""
        mobility = getattr(model, "mobility", None)
        mobility = mobility if isinstance(mobility, KernelTensor) else None
        learned = as_learned_force(model.environment)
        if learned is not None and not learned.is_linear:
            learned = None  # a network
        return dataclasses.replace(self, environment=learned, mobility=mobility)


def summarise_data(data: Trajectories) -> DataSummary:
    """The summary of trajectories for a model that is a network."""
    is_observed = data.observed
    columns = [
        data.states[..., i][is_observed[..., i]] for i in range(is_observed.shape[2])
    ]
    columns.append(data.times[is_observed.any(axis=-1)])
    deviations = [float(column.std()) if column.size else 0.0 for column in columns]
    return DataSummary(
        dim=data.dim,
        mean=tuple(float(column.mean()) if column.size else 0.0 for column in columns),
        std=tuple(value if value > 0 else 1.0 for value in deviations),
    )


def summarise_for_matching(
    choice: ModelChoice, swimmer: Any, data: Trajectories
) -> DataSummary:
    """The summary of trajectories without noise.

    Kernels are as fine as the data ask for, and the positions that a network sees are
    standardised where the force acts.
    """
    summary = summarise_for(choice, data)
    rates = observed_rates(data) if isinstance(swimmer, Swimmer) else None
    if rates is None:
        return summary
    if choice.name == "kernel-potential":
        laid = kernels_of(KernelPotential, swimmer, rates)
        return dataclasses.replace(summary, environment=laid)
    if summary.environment is not None:
        laid = kernels_of(KernelForce, swimmer, rates).kernels
        assert laid is not None  # kernels are laid on places
        places = np.asarray(laid.centers), float(laid.width)
        made = summary.environment.kernels_on(*places)
        return dataclasses.replace(summary, environment=made)
    few, dim = thin_rates(rates, MOST_SAMPLES), summary.dim
    if choice.name in POSITION_NETWORKS:
        region = force_region(few, residual_forces(swimmer, few))
    elif choice.name == BLACK_BOX:
        region = force_region(
            few, forces_beside_drag(few.states[:, dim:], few.rates[:, dim:])
        )
    else:
        return summary
    if region is None:
        return summary
    return dataclasses.replace(
        summary,
        mean=(*map(float, region.center), *summary.mean[dim:]),
        std=(*[region.radius] * dim, *summary.std[dim:]),
    )


def summarise_for(choice: ModelChoice, data: Trajectories) -> DataSummary:
    """The summary of trajectories for a model, and its kernels if it has any."""
    summary = summarise_data(data)
    if choice.name not in KERNELS:
        return summary
    environment = KERNELS[choice.name](data, dim=data.dim)
    return dataclasses.replace(summary, environment=environment)


KERNELS: dict[str, Callable[..., AbstractLearnedForce]] = {
    "kernel-potential": partial(kernel_environment, KernelPotential),
    "kernel-force": partial(kernel_environment, KernelForce),
    MIXTURE: partial(kernel_environment, KernelMixture),
    TIMED: changing_environment,
}
"""Untrained environments of kernels around data, by the names of models."""
