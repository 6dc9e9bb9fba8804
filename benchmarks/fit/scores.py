"""What a contestant learned, solved anew in float64 and compared with the truth."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pinav.dynamics import Swimmer
from pinav.evaluation import field_map, force_errors, predict, score
from pinav.forces import (
    KernelPotential,
    MagneticPropulsion,
    NeuralForce,
    PositionTimeFeatures,
    tanh_network,
)
from pinav.systems import System
from pinav.trajectories import simulate

LIMITS = {"paper": None, "barrier-crossings": (-2.0, 12.0, -2.0, 12.0)}
"""Of the force map [L]; around the data unless given."""


def scores(scenario: System, arrays: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Errors of a learned model, whatever its data were.

    Rollouts start at the true starts and are compared with the clean truth.

    Args:
        scenario: what the contestant was to learn.
        arrays: what it handed back.

    Returns:
        `rmse` of all states, and `force`, the relative error on visited ground.
    """
    clean = simulate(eqx.tree_at(lambda s: s.observation.noise, scenario, 0.0))
    truth: Any = scenario.true_swimmer
    learned = rebuilt(truth, arrays)
    limits = LIMITS[scenario.name]
    learned_map, true_map = (
        field_map(swimmer.environment, clean, limits=limits)
        for swimmer in (learned, truth)
    )
    return {
        "rmse": score(*predict(learned, clean), clean).total,
        "force": force_errors(learned_map, true_map)["visited"],
    }


def rebuilt(known: Swimmer, arrays: Mapping[str, np.ndarray]) -> Swimmer:
    """The swimmer that a contestant's arrays describe, in float64."""
    if "weight0" in arrays:
        return known.with_environment(_neural_force(arrays))
    environment = KernelPotential(
        jnp.asarray(arrays["weights"]),
        jnp.asarray(arrays["centers"]),
        float(arrays["width"]),
    )
    return eqx.tree_at(
        lambda s: (s.environment, s.drag.damping, s.propulsion.gain),
        known,
        (environment, float(arrays["damping"]), _gain(known, arrays)),
    )


def _gain(known: Swimmer, arrays) -> float:
    """Gain of the propulsion; some tools learn the thrust, its multiple."""
    if "gain" in arrays:
        return float(arrays["gain"])
    propulsion = known.propulsion
    assert isinstance(propulsion, MagneticPropulsion)
    return float(arrays["thrust"] / jnp.linalg.norm(propulsion.torque(0.0)))


def _neural_force(arrays) -> NeuralForce:
    depth = sum(name.startswith("weight") for name in arrays)
    layers = [(arrays[f"weight{i}"], arrays[f"bias{i}"]) for i in range(depth)]
    width, inputs = layers[0][0].shape
    outputs = layers[-1][0].shape[0]
    network = tanh_network(
        inputs, outputs, width=width, depth=depth - 1, key=jax.random.key(0)
    )
    network = eqx.tree_at(
        lambda net: [a for layer in net.layers for a in (layer.weight, layer.bias)],
        network,
        [jnp.asarray(a, jnp.float64) for layer in layers for a in layer],
    )
    center, scale = arrays["center"].tolist(), arrays["scale"].tolist()
    return NeuralForce(network, PositionTimeFeatures(tuple(center), tuple(scale)))
