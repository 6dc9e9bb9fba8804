"""The choice of a model, and the numbers that an untrained one takes from data."""

from operator import attrgetter
from typing import Any

import msgspec
import numpy as np

from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.fitting.environments.force_regression import Layer
from pinav.fitting.environments.gradient_matching import (
    lay_kernels_of,
    match_kernels,
    match_potential,
)
from pinav.fitting.environments.kernels import (
    WITHOUT_PRIOR,
    KernelGrid,
    MobilitySummary,
    ProfileSummary,
    changing_environment,
    kernel_environment,
)
from pinav.fitting.environments.rates import (
    MOST_SAMPLES,
    force_region,
    forces_beside_drag,
    observed_rates,
    residual_forces,
    thin_rates,
)
from pinav.fitting.environments.terms import TermSummary, summarise_terms
from pinav.forces import AbstractForce, KernelForce, KernelPotential, as_learned_force
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


class Change(msgspec.Struct, frozen=True):
    """Kernels and splines of a potential that changes with time.

    Attributes:
        splines: number of functions of time.
        times: first and last time [T].
    """

    centers: list[list[float]]
    width: float
    splines: int
    times: tuple[float, float]


class KernelLayer(msgspec.Struct, frozen=True):
    """Kernels of one width."""

    centers: list[list[float]]
    width: float


class DataSummary(msgspec.Struct, frozen=True):
    """The numbers that an untrained model takes from the data.

    Attributes:
        mean: of each observed state, then of time.
        std: standard deviation of each of them; 1 where it is zero.
        centers: of the kernels around the data [L].
        change: the part that changes with time, where the model has one.
        finer: further layers of kernels, each finer than the one before.
        terms: with a structure, beside the kernels.
        profile: a force in coordinates of its own, where the model is one.
        mobility: where it is learned.
    """

    dim: int
    mean: tuple[float, ...]
    std: tuple[float, ...]
    centers: list[list[float]]
    kernel_width: float
    change: Change | None = None
    finer: tuple[KernelLayer, ...] = ()
    terms: tuple[TermSummary, ...] = ()
    profile: ProfileSummary | None = None
    mobility: MobilitySummary | None = None

    def with_kernels_of(self, environment: AbstractForce) -> "DataSummary":
        """The summary of a fitted model, whose kernels may be finer than at first."""
        learned = as_learned_force(environment)
        if learned is None or learned.kernels is None:
            return self
        kernels = learned.kernels
        return msgspec.structs.replace(
            self,
            centers=np.asarray(kernels.centers).tolist(),
            kernel_width=float(kernels.width),
            terms=summarise_terms(learned),
        )


def summarise_data(
    data: Trajectories, grid: KernelGrid | None = WITHOUT_PRIOR
) -> DataSummary:
    """The summary of trajectories for a model without a prior.

    Args:
        grid: how kernels are laid around them; that of `kernel_environment` where None.
    """
    is_observed = data.observed
    columns = [
        data.states[..., i][is_observed[..., i]] for i in range(is_observed.shape[2])
    ]
    columns.append(data.times[is_observed.any(axis=-1)])
    deviations = [float(column.std()) if column.size else 0.0 for column in columns]
    kernels = kernel_environment(KernelPotential, data, grid, dim=data.dim)
    return DataSummary(
        dim=data.dim,
        mean=tuple(float(column.mean()) if column.size else 0.0 for column in columns),
        std=tuple(value if value > 0 else 1.0 for value in deviations),
        centers=np.asarray(kernels.centers).tolist(),
        kernel_width=float(kernels.width),
    )


def summarise_for_matching(
    choice: ModelChoice, swimmer: Any, data: Trajectories
) -> DataSummary:
    """The summary of trajectories without noise.

    Kernels are as fine as the data ask for, and the positions that a network sees are
    standardised where the force acts.
    """
    summary = summarise_data(data)
    rates = observed_rates(data) if isinstance(swimmer, Swimmer) else None
    if rates is None:
        return summary
    if choice.name == "kernel-potential":
        return _with_layers(summary, match_potential(swimmer, rates))
    if choice.name.startswith("kernel-"):
        laid = lay_kernels_of(KernelForce, swimmer, rates)
        return summary.with_kernels_of(laid or match_kernels(swimmer, rates))
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
    return msgspec.structs.replace(
        summary,
        mean=(*map(float, region.center), *summary.mean[dim:]),
        std=(*[region.radius] * dim, *summary.std[dim:]),
    )


def _with_layers(summary: DataSummary, layers: tuple[Layer, ...]) -> DataSummary:
    first, *finer = (KernelLayer(centers.tolist(), width) for centers, width in layers)
    return msgspec.structs.replace(
        summary, centers=first.centers, kernel_width=first.width, finer=tuple(finer)
    )


def summarise_for(choice: ModelChoice, data: Trajectories) -> DataSummary:
    """The summary of trajectories for a model with a prior, and its kernels."""
    summary = summarise_data(data, None)
    if choice.name != TIMED:
        return summary
    change = changing_environment(data, dim=summary.dim).change
    timed = Change(
        centers=np.asarray(change.centers).tolist(),
        width=float(change.width),
        splines=change.weights.shape[1],
        times=(float(change.first), float(change.last)),
    )
    return msgspec.structs.replace(summary, change=timed)
