"""Neural environments made from data."""

from typing import TypeVar

import numpy as np
from jaxtyping import Float, PRNGKeyArray

from pinav.errors import InputError
from pinav.forces import (
    NeuralForce,
    NeuralPotential,
    PositionFeatures,
    spread_weights,
    tanh_network,
)
from pinav.trajectories import Trajectories, smooth_states

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
