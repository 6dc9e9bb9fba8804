"""The models by name: what stands for the unknown, built from a choice and the data.

A `ModelChoice` and a `DataSummary` are all that a file needs to say so that the model
in it can be built again. A further model is one function and one entry of `MODELS`.
"""

import dataclasses
from collections.abc import Callable
from operator import attrgetter
from typing import Any

import jax
import jax.numpy as jnp
import msgspec
import numpy as np

from pinav.dynamics import (
    AbstractDynamics,
    NeuralDynamics,
    OverdampedSwimmer,
    Swimmer,
    paper_black_box,
)
from pinav.errors import InputError
from pinav.fitting.environments.gradient_matching import (
    lay_kernels_of,
    match_kernels,
    match_potential,
)
from pinav.fitting.environments.kernel_layers import Layer
from pinav.fitting.environments.kernels import (
    WITHOUT_PRIOR,
    KernelGrid,
    changing_environment,
    kernel_environment,
)
from pinav.fitting.environments.profiles import MobilitySummary, ProfileSummary
from pinav.fitting.environments.rates import force_region, observed_rates
from pinav.fitting.environments.terms import (
    TermSummary,
    summarise_terms,
    with_terms,
)
from pinav.forces import (
    AbstractForce,
    AbstractLearnedForce,
    ChangingPotential,
    CholeskyTensor,
    KernelForce,
    KernelMixture,
    KernelPotential,
    KernelProfile,
    LayeredPotential,
    LinearDrag,
    NeuralForce,
    NeuralPotential,
    PositionFeatures,
    PositionTimeFeatures,
    StructuredForce,
    TensorDrag,
    TimedKernelPotential,
    ZeroForce,
    as_learned_force,
    paper_force,
    spread_weights,
    tanh_network,
    tensor_matrix,
)
from pinav.trajectories import Trajectories

KnownSwimmer = Swimmer | OverdampedSwimmer
"""Physics whose environment alone is unknown."""

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


class Change(msgspec.Struct, frozen=True):
    """Kernels and splines of a potential that changes with time.

    Attributes:
        centers: of the kernels [L].
        width: of the kernels [L].
        splines: number of functions of time.
        times: first and last time [T].
    """

    centers: list[list[float]]
    width: float
    splines: int
    times: tuple[float, float]


class KernelLayer(msgspec.Struct, frozen=True):
    """Kernels of one width.

    Attributes:
        centers: of the kernels [L].
        width: of the kernels [L].
    """

    centers: list[list[float]]
    width: float


class DataSummary(msgspec.Struct, frozen=True):
    """The numbers that an untrained model takes from the data.

    Attributes:
        dim: number of coordinates.
        mean: of each observed state, then of time.
        std: standard deviation of each of them; 1 where it is zero.
        centers: of the kernels around the data [L].
        kernel_width: of these kernels [L].
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
        data: the trajectories.
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

    Args:
        choice: the model.
        swimmer: the known physics.
        data: the trajectories.
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
    region = force_region(swimmer, rates) if choice.name in POSITION_NETWORKS else None
    if region is None:
        return summary
    dim = summary.dim
    return msgspec.structs.replace(
        summary,
        mean=(*map(float, region.center), *summary.mean[dim:]),
        std=(*[region.radius] * dim, *summary.std[dim:]),
    )


def _with_layers(summary: DataSummary, layers: tuple[Layer, ...]) -> DataSummary:
    first, *finer = (
        KernelLayer(layer.centers.tolist(), layer.width) for layer in layers
    )
    return msgspec.structs.replace(
        summary, centers=first.centers, kernel_width=first.width, finer=tuple(finer)
    )


def summarise_for(choice: ModelChoice, data: Trajectories) -> DataSummary:
    """The summary of trajectories for a model with a prior, and its kernels.

    Args:
        choice: the model.
        data: the trajectories.
    """
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


Builder = Callable[[ModelChoice, KnownSwimmer, DataSummary], AbstractDynamics]


def build(
    choice: ModelChoice, swimmer: KnownSwimmer, summary: DataSummary
) -> AbstractDynamics:
    """The untrained model.

    Args:
        choice: its kind, size and seed.
        swimmer: the known physics.
        summary: what the model takes from the data.

    Raises:
        InputError: there is no model of that name, or it does not suit the swimmer.
    """
    if choice.name not in MODELS:
        raise InputError(
            f"model {choice.name!r} is unknown; choose one of: {', '.join(MODELS)}"
        )
    if CONSTANTS["drag"] in choice.paths().values():
        swimmer = with_tensor_drag(swimmer, summary)
    if summary.mobility is not None:
        swimmer = dataclasses.replace(swimmer, mobility=summary.mobility.mobility())
    model = MODELS[choice.name](choice, swimmer, summary)
    return with_terms(model, summary.terms)


def _in_environment(
    environment: Callable[[ModelChoice, DataSummary], AbstractForce],
) -> Builder:
    """A model that differs from the known swimmer by its environment alone."""
    return lambda choice, swimmer, summary: swimmer.with_environment(
        environment(choice, summary)
    )


def _kernels(
    kind: type[KernelForce] | type[KernelMixture],
) -> Builder:
    return _in_environment(
        lambda choice, summary: kind.with_zero_weights(
            np.asarray(summary.centers), summary.kernel_width
        )
    )


def _potential(
    choice: ModelChoice, summary: DataSummary
) -> KernelPotential | LayeredPotential:
    """Kernels of one width, or of several."""
    first = KernelLayer(summary.centers, summary.kernel_width)
    layers = tuple(
        KernelPotential.with_zero_weights(np.asarray(layer.centers), layer.width)
        for layer in (first, *summary.finer)
    )
    return LayeredPotential(layers) if summary.finer else layers[0]


def _profile(choice: ModelChoice, summary: DataSummary) -> KernelProfile:
    if summary.profile is None:
        raise InputError(f"model {choice.name}: its summary has no coordinates")
    return summary.profile.profile(summary.dim)


def _changing_potential(choice: ModelChoice, summary: DataSummary) -> ChangingPotential:
    change = summary.change
    if change is None:
        raise InputError(f"model {choice.name}: its summary of the data has no times")
    centers = jnp.asarray(change.centers)
    weights = jnp.zeros((len(centers), change.splines))
    static = KernelPotential.with_zero_weights(
        np.asarray(summary.centers), summary.kernel_width
    )
    timed = TimedKernelPotential(weights, centers, change.width, *change.times)
    return ChangingPotential(static, timed)


def _timed_network(choice: ModelChoice, summary: DataSummary) -> NeuralForce:
    """A network of standardised position and time, its weights spread."""
    dim, mean, std = summary.dim, summary.mean, summary.std
    features = PositionTimeFeatures((*mean[:dim], mean[-1]), (*std[:dim], std[-1]))
    return NeuralForce(_network(choice, dim + 1, dim), features)


def _static_network(kind: type[NeuralForce] | type[NeuralPotential]) -> Builder:
    def environment(choice: ModelChoice, summary: DataSummary) -> AbstractForce:
        dim, mean, std = summary.dim, summary.mean, summary.std
        outputs = dim if kind is NeuralForce else 1
        features = PositionFeatures(mean[:dim], std[:dim])
        return kind(_network(choice, dim, outputs), features)

    return _in_environment(environment)


def _network(choice: ModelChoice, inputs: int, outputs: int) -> Any:
    key = jax.random.key(choice.seed)
    size = {"width": choice.width, "depth": choice.depth}
    return spread_weights(tanh_network(inputs, outputs, **size, key=key))


def _black_box(
    choice: ModelChoice, swimmer: KnownSwimmer, summary: DataSummary
) -> NeuralDynamics:
    """A network of the standardised state and time in place of all physics."""
    del swimmer
    inputs = len(summary.mean)
    network = _network(choice, inputs, inputs - 1)
    return NeuralDynamics(network, summary.mean, summary.std)


def _paper_black_box(
    choice: ModelChoice, swimmer: KnownSwimmer, summary: DataSummary
) -> NeuralDynamics:
    del swimmer, summary
    return paper_black_box(jax.random.key(choice.seed))


POSITION_NETWORKS = ("neural-potential", "neural-force", "ude")
"""Models whose network sees standardised positions."""

MIXTURE = "kernel-mixture"
"""The model with a gradient and a rotational part."""

TIMED = "kernel-potential-time"
"""The model whose environment changes with time and has a prior."""

PROFILE = "kernel-profile"
"""The model whose force depends on some coordinates alone."""

MODELS: dict[str, Builder] = {
    "kernel-potential": _in_environment(_potential),
    "kernel-force": _kernels(KernelForce),
    MIXTURE: _kernels(KernelMixture),
    TIMED: _in_environment(_changing_potential),
    "neural-potential": _static_network(NeuralPotential),
    "neural-force": _static_network(NeuralForce),
    "ude": _in_environment(_timed_network),
    "physics-only": _in_environment(lambda choice, summary: ZeroForce()),
    "nn-only": _black_box,
    PROFILE: _in_environment(_profile),
    "paper-ude": _in_environment(
        lambda choice, summary: paper_force(jax.random.key(choice.seed))
    ),
    "paper-nn-only": _paper_black_box,
}
"""Models by name; those of the paper have its networks as Table 1 states them."""


def is_mixture(environment: AbstractForce) -> bool:
    """Whether the free kernels of a force have a rotational part beside a gradient."""
    if isinstance(environment, StructuredForce):
        environment = environment.remainder
    return isinstance(environment, KernelMixture)


def learned_part(model: Any) -> Any:
    """The part of a model that trains unless more is asked for."""
    learned = model.environment if isinstance(model, KnownSwimmer) else model
    if isinstance(learned, AbstractForce) and not isinstance(
        learned, AbstractLearnedForce
    ):
        return ()
    if isinstance(learned, AbstractLearnedForce) and learned.geometry:
        return learned.parameters, learned.geometry
    return learned.parameters


def with_tensor_drag(swimmer: KnownSwimmer, summary: DataSummary) -> KnownSwimmer:
    """The swimmer with a tensor to learn as its drag; isotropic at first."""
    matrix = mean_drag(swimmer, summary) * jnp.eye(summary.dim)
    return dataclasses.replace(swimmer, drag=TensorDrag(CholeskyTensor.of(matrix)))


def with_linear_drag(swimmer: KnownSwimmer, summary: DataSummary) -> KnownSwimmer:
    """The swimmer with a number to learn as its drag."""
    drag = LinearDrag(mean_drag(swimmer, summary))
    return dataclasses.replace(swimmer, drag=drag)


def mean_drag(swimmer: KnownSwimmer, summary: DataSummary | None = None) -> float:
    """Drag averaged over all directions, in the middle of the data [T⁻¹].

    Args:
        swimmer: the known physics.
        summary: of the data; their middle is the origin unless given.

    Raises:
        InputError: the swimmer has no drag that depends on its velocity alone.
    """
    drag = swimmer.drag if isinstance(swimmer, Swimmer) else None
    if isinstance(drag, LinearDrag):
        return float(drag.damping)
    if isinstance(drag, TensorDrag):
        dim = 2 if summary is None else summary.dim
        middle = jnp.zeros(dim) if summary is None else jnp.asarray(summary.mean[:dim])
        return float(jnp.trace(tensor_matrix(drag.tensor, middle)) / dim)
    raise InputError(
        "learning the drag needs physics with inertia and a drag in a fluid at rest, "
        f"got {type(swimmer if drag is None else drag).__name__}; leave the drag out"
    )
