"""The models by name: what stands for the unknown, built from a choice and the data.

A `ModelChoice` and a `DataSummary` are all that a file needs to say so that the model
in it can be built again. A further model is one function and one entry of `MODELS`.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from pinav.dynamics import AbstractDynamics, NeuralDynamics, Swimmer, paper_black_box
from pinav.errors import InputError
from pinav.fitting.environments.summary import (
    BLACK_BOX,
    CONSTANTS,
    KERNELS,
    PROFILE,
    DataSummary,
    KnownSwimmer,
    ModelChoice,
)
from pinav.forces import (
    AbstractForce,
    CholeskyTensor,
    LinearDrag,
    NeuralForce,
    NeuralPotential,
    PositionFeatures,
    PositionTimeFeatures,
    TensorDrag,
    ZeroForce,
    paper_force,
    spread_weights,
    tanh_network,
    tensor_matrix,
)
from pinav.trajectories import Trajectories, smooth_states


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


Builder = Callable[[ModelChoice, KnownSwimmer, DataSummary], AbstractDynamics]


def build(
    choice: ModelChoice, swimmer: KnownSwimmer, summary: DataSummary
) -> AbstractDynamics:
    """The untrained model.

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
        swimmer = dataclasses.replace(swimmer, mobility=summary.mobility)
    return MODELS[choice.name](choice, swimmer, summary)


def _in_environment(
    environment: Callable[[ModelChoice, DataSummary], AbstractForce],
) -> Builder:
    """A model that differs from the known swimmer by its environment alone."""
    return lambda choice, swimmer, summary: swimmer.with_environment(
        environment(choice, summary)
    )


def _laid(choice: ModelChoice, summary: DataSummary) -> AbstractForce:
    """The untrained kernels or profile around the data."""
    if summary.environment is None:
        raise InputError(f"model {choice.name}: its summary of the data has no kernels")
    return summary.environment


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


MODELS: dict[str, Builder] = {
    **dict.fromkeys(KERNELS, _in_environment(_laid)),
    "neural-potential": _static_network(NeuralPotential),
    "neural-force": _static_network(NeuralForce),
    "ude": _in_environment(_timed_network),
    "physics-only": _in_environment(lambda choice, summary: ZeroForce()),
    BLACK_BOX: _black_box,
    PROFILE: _in_environment(_laid),
    "paper-ude": _in_environment(
        lambda choice, summary: paper_force(jax.random.key(choice.seed))
    ),
    "paper-nn-only": _paper_black_box,
}
"""Models by name; those of the paper have its networks as Table 1 states them."""


Neural = TypeVar("Neural", NeuralForce, NeuralPotential)


def neural_environment(
    kind: type[Neural],
    trajectories: Trajectories,
    *,
    key: PRNGKeyArray,
    width: int = 32,
    depth: int = 2,
    dim: int | None = None,
) -> Neural:
    r"""An untrained static network whose inputs and output are of order one.

    Positions are standardised by their mean and one standard deviation $s$ for all
    directions. One unit of force is the mean square speed over $s$ or, where the state
    is the position, the speed.

    Args:
        trajectories: their channels are positions, then as many velocities.
        width: neurons of each hidden layer, positive.
        dim: how many of the channels are positions, where that is not half of them.

    Raises:
        InputError: a trajectory is too short to smooth, or all positions are the same.
    """
    count = len(trajectories.channels)
    dim = count // 2 if dim is None else dim
    states = smooth_states(trajectories, dim)
    real = np.arange(states.shape[1]) < trajectories.lengths[:, None]
    positions = states[real][:, :dim]
    spread = float(np.sqrt(positions.var(axis=0).mean()))
    if not spread > 1e-9 * float(np.abs(positions).max()):  # smoothing rounds
        raise InputError(
            "neural_environment: expected positions that differ, got the same "
            "everywhere"
        )
    force = _typical_force(trajectories, states, dim, spread)
    outputs = dim if kind is NeuralForce else 1
    network = tanh_network(dim, outputs, width=width, depth=depth, key=key)
    center = tuple(float(value) for value in positions.mean(axis=0))
    features = PositionFeatures(center, (spread,) * dim)
    scale = force if kind is NeuralForce else force * spread
    return kind(spread_weights(network), features, scale)


def _typical_force(
    trajectories: Trajectories,
    states: Float[np.ndarray, "trajectory time state"],
    dim: int,
    spread: float,
) -> float:
    """A force that matters over the extent of the data; 1 where nothing moves."""
    real = np.arange(states.shape[1]) < trajectories.lengths[:, None]
    if len(trajectories.channels) > dim:
        speed_squared = np.mean(np.sum(states[real][:, dim:] ** 2, axis=1))
        return float(speed_squared / spread) or 1.0
    step = np.diff(states, axis=1)[real[:, 1:]]
    interval = np.diff(trajectories.times, axis=1)[real[:, 1:]]
    speed_squared = np.mean(np.sum((step / interval[:, None]) ** 2, axis=1))
    return float(np.sqrt(speed_squared)) or 1.0
