"""Models by name: what a model file says of itself, and how to build it again."""

from collections.abc import Callable
from operator import attrgetter
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pinav.commands.fit.settings import FitSettings
from pinav.dynamics import (
    NeuralDynamics,
    OverdampedSwimmer,
    Swimmer,
    paper_black_box,
    with_dtype,
)
from pinav.errors import InputError
from pinav.fitting import (
    WITHOUT_PRIOR,
    KernelGrid,
    changing_environment,
    kernel_environment,
)
from pinav.forces import (
    AbstractForce,
    AbstractLearnedForce,
    ChangingPotential,
    CholeskyTensor,
    KernelForce,
    KernelMixture,
    KernelPotential,
    LinearDrag,
    NeuralForce,
    NeuralPotential,
    PositionFeatures,
    PositionTimeFeatures,
    TensorDrag,
    TimedKernelPotential,
    ZeroForce,
    paper_force,
    spread_weights,
    tanh_network,
    tensor_matrix,
)
from pinav.scenarios import scenario
from pinav.systems import System
from pinav.trajectories import Trajectories

Trainable = Callable[[Any], Any]

KnownSwimmer = Swimmer | OverdampedSwimmer
"""Physics whose environment alone is unknown."""


def paper_ude(known: KnownSwimmer, seed: int) -> KnownSwimmer:
    """Known propulsion and drag with the paper's untrained network (Table 1)."""
    environment = paper_force(jax.random.key(seed))
    return known.with_environment(environment)


def paper_nn_only(known: Swimmer, seed: int) -> NeuralDynamics:
    """The network-only baseline; it knows nothing of the swimmer."""
    del known
    return paper_black_box(jax.random.key(seed))


def default_ude(known: KnownSwimmer, seed: int, data: dict[str, Any]) -> KnownSwimmer:
    """The paper's network on standardised (x, y, t), its weights spread."""
    environment = paper_force(jax.random.key(seed))
    center, scale = data["mean"], data["std"]
    inputs = [0, 1, len(center) - 1]
    features = PositionTimeFeatures(
        tuple(center[i] for i in inputs), tuple(scale[i] for i in inputs)
    )
    environment = NeuralForce(spread_weights(environment.network), features)
    return known.with_environment(environment)


def default_nn_only(known: Swimmer, seed: int, data: dict[str, Any]) -> NeuralDynamics:
    """The black box on standardised (x, y, vx, vy, t), its weights spread."""
    del known
    network = spread_weights(paper_black_box(jax.random.key(seed)).network)
    return NeuralDynamics(network, tuple(data["mean"]), tuple(data["std"]))


def default_kernel(
    known: KnownSwimmer, seed: int | None, data: dict[str, Any]
) -> KnownSwimmer:
    """A kernel potential around the data, zero before training; it has no seed."""
    del seed
    return known.with_environment(_kernels(KernelPotential, data))


REPRODUCED: dict[str, dict[str, Callable[..., Any]]] = {
    "paper": {
        "ude": lambda known, seed, data: paper_ude(known, seed),
        "nn-only": lambda known, seed, data: paper_nn_only(known, seed),
    },
    "default": {
        "ude": default_ude,
        "nn-only": default_nn_only,
        "ude-kernel": default_kernel,
    },
}
"""Untrained models of each recipe, by the name of their row in Table 2."""

SEEDLESS = ("ude-kernel",)
"""Models without random numbers."""


CONSTANTS = {
    "damping": "drag.damping",
    "gain": "propulsion.gain",
    "drag": "drag.tensor",
}
"""Known constants that `pinav fit --learn` can train, and where they stand."""

KERNELS = {
    "kernel-potential": KernelPotential,
    "kernel-force": KernelForce,
    "kernel-mixture": KernelMixture,
}
"""Static kernel environments of `pinav fit`."""

TIMED = "kernel-potential-time"
"""The one that changes with time."""


def residual(model: Any) -> Any:
    """The learned part of a model: what trains unless more is asked for."""
    learned = model.environment if isinstance(model, KnownSwimmer) else model
    if isinstance(learned, AbstractForce) and not isinstance(
        learned, AbstractLearnedForce
    ):
        return ()
    return learned.parameters


def fit_model(settings: FitSettings, known: KnownSwimmer, data: dict[str, Any]) -> Any:
    """The untrained model of `pinav fit`.

    Args:
        settings: its kind, size and seed.
        known: swimmer whose propulsion and drag are known.
        data: what it takes from the data, from `data_summary`.
    """
    if settings.model == "nn-only":
        mean, std = tuple(data["mean"]), tuple(data["std"])
        network = _network(settings, len(mean), len(mean) - 1)
        return NeuralDynamics(network, mean, std)
    if "drag" in settings.learn:
        known = with_tensor_drag(known, data)
    return known.with_environment(_environment(settings, data))


def with_tensor_drag(known: KnownSwimmer, data: dict[str, Any]) -> KnownSwimmer:
    """The swimmer with a tensor to learn as its drag; isotropic at first."""
    matrix = mean_drag(known, data) * jnp.eye(data["dim"])
    drag = TensorDrag(CholeskyTensor.of(matrix))
    return eqx.tree_at(lambda swimmer: swimmer.drag, known, drag)


def with_linear_drag(known: KnownSwimmer, data: dict[str, Any]) -> KnownSwimmer:
    """The swimmer with a number to learn as its drag."""
    drag = LinearDrag(float(mean_drag(known, data)))
    return eqx.tree_at(lambda swimmer: swimmer.drag, known, drag)


def mean_drag(known: KnownSwimmer, data: dict[str, Any]) -> float:
    """Drag averaged over all directions, in the middle of the data [T⁻¹].

    Raises:
        InputError: the swimmer has no drag that depends on its velocity alone.
    """
    drag = known.drag if isinstance(known, Swimmer) else None
    if isinstance(drag, LinearDrag):
        return float(drag.damping)
    if isinstance(drag, TensorDrag):
        middle = jnp.asarray(data["mean"][: data["dim"]])
        return float(jnp.trace(tensor_matrix(drag.tensor, middle)) / data["dim"])
    raise InputError(
        "--learn drag: expected physics with inertia and a drag in a fluid at rest, "
        f"got {type(known).__name__ if drag is None else type(drag).__name__}; drop it"
    )


def _environment(settings: FitSettings, data: dict[str, Any]) -> AbstractForce:
    if settings.model == "physics-only":
        return ZeroForce()
    if settings.model in KERNELS:
        return _kernels(KERNELS[settings.model], data)
    if settings.model == TIMED:
        return _changing(data)
    mean, std, dim = data["mean"], data["std"], data["dim"]
    if settings.model == "ude":
        center, scale = (*mean[:dim], mean[-1]), (*std[:dim], std[-1])
        network = _network(settings, dim + 1, dim)
        return NeuralForce(network, PositionTimeFeatures(center, scale))
    features = PositionFeatures(tuple(mean[:dim]), tuple(std[:dim]))
    if settings.model == "neural-force":
        return NeuralForce(_network(settings, dim, dim), features)
    return NeuralPotential(_network(settings, dim, 1), features)


def _network(settings: FitSettings, inputs: int, outputs: int):
    size = {"width": settings.width, "depth": settings.depth}
    key = jax.random.key(settings.seed)
    return spread_weights(tanh_network(inputs, outputs, **size, key=key))


def _kernels(kind, data: dict[str, Any]):
    return kind.untrained(np.asarray(data["centers"]), data["kernel_width"])


def _changing(data: dict[str, Any]) -> ChangingPotential:
    change = data["change"]
    centers = jnp.asarray(change["centers"])
    weights = jnp.zeros((len(centers), change["splines"]))
    return ChangingPotential(
        _kernels(KernelPotential, data),
        TimedKernelPotential(weights, centers, change["width"], *change["times"]),
    )


def fit_trainable(settings: FitSettings) -> Trainable:
    """Selects the leaves that `pinav fit` trains."""
    constants = fit_constants(settings)
    return lambda model: (residual(model), *constants(model))


def fit_constants(settings: FitSettings) -> Trainable:
    """Selects the constants of `--learn`."""
    chosen = [attrgetter(CONSTANTS[name]) for name in settings.learn]
    return lambda model: tuple(pick(model) for pick in chosen)


def data_summary(
    trajectories: Trajectories, grid: KernelGrid = WITHOUT_PRIOR
) -> dict[str, Any]:
    """What an untrained model takes from the data; JSON values.

    Args:
        trajectories: the data.
        grid: how kernels are laid around them.

    Returns:
        The number of position channels; mean and standard deviation of each state,
        where it was observed, and of time; centres and width of kernels.
    """
    dim = trajectories.dim
    seen = trajectories.observed
    columns = [trajectories.states[..., i][seen[..., i]] for i in range(seen.shape[2])]
    columns.append(trajectories.times[seen.any(axis=-1)])
    mean = [float(column.mean()) if column.size else 0.0 for column in columns]
    std = [float(column.std()) if column.size else 0.0 for column in columns]
    kernels = kernel_environment(KernelPotential, trajectories, grid, dim=dim)
    return {
        "dim": dim,
        "mean": mean,
        "std": [value if value > 0 else 1.0 for value in std],
        "centers": np.asarray(kernels.centers).tolist(),
        "kernel_width": float(kernels.width),
    }


def model_summary(model: str, trajectories: Trajectories) -> dict[str, Any]:
    """What a model with a prior takes from the data: `data_summary`, and its kernels.

    Args:
        model: its name in `pinav fit`.
        trajectories: the data.
    """
    summary = data_summary(trajectories, KernelGrid())
    if model != TIMED:
        return summary
    change = changing_environment(trajectories, dim=summary["dim"]).change
    return summary | {
        "change": {
            "centers": np.asarray(change.centers).tolist(),
            "width": float(change.width),
            "splines": change.weights.shape[1],
            "times": [float(change.first), float(change.last)],
        }
    }


def fitted_summary(summary: dict[str, Any], environment: AbstractForce) -> Any:
    """The summary of a fitted model, whose kernels may be finer than at the start.

    Args:
        summary: of the untrained model.
        environment: the fitted one.
    """
    kernels = getattr(environment, "kernels", None)
    if kernels is None:
        return summary
    return summary | {
        "centers": np.asarray(kernels.centers).tolist(),
        "kernel_width": float(kernels.width),
    }


def known_physics(name: str | None, trajectories: Trajectories) -> System:
    """The scenario that supplies propulsion and drag.

    Raises:
        InputError: no name is given and the data do not say where they come from.
    """
    name = name or trajectories.provenance.get("scenario")
    if name is None:
        raise InputError(
            "--physics: the data name no scenario; give the one that supplies "
            "propulsion and drag, such as --physics paper"
        )
    return scenario(name)


def build_model(header: dict[str, Any]) -> Any:
    """An untrained model of the shape that a model file's header describes.

    Raises:
        InputError: the header is not one of ours.
    """
    try:
        known = scenario(header["physics"]).swimmer
        if header["kind"] in REPRODUCED:
            build = REPRODUCED[header["kind"]][header["name"]]
            model = build(known, header["seed"], header.get("data"))
        else:
            settings = FitSettings(**header["settings"])
            model = fit_model(settings, known, header["data"])
        return with_dtype(model, jnp.dtype(header["dtype"]))
    except (KeyError, TypeError) as error:
        raise InputError(
            f"model file: its first line misses or misnames {error}"
        ) from error
