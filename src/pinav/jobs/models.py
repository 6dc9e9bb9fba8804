"""Models by name: what a model file says of itself, and how to build it again."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pinav.dynamics import (
    NeuralDynamics,
    Swimmer,
    paper_black_box,
    with_dtype,
)
from pinav.errors import InputError
from pinav.jobs.settings import FitSettings
from pinav.learned import (
    NeuralForce,
    PositionFeatures,
    PositionTimeFeatures,
    kernel_potential,
    paper_force,
    spread_weights,
    tanh_network,
)
from pinav.scenarios import Scenario, scenario
from pinav.trajectories import Trajectories

Trainable = Callable[[Any], Any]


def paper_ude(known: Swimmer, seed: int) -> Swimmer:
    """Known propulsion and drag with the paper's untrained network (Table 1)."""
    environment = paper_force(jax.random.key(seed))
    return eqx.tree_at(lambda swimmer: swimmer.environment, known, environment)


def paper_nn_only(known: Swimmer, seed: int) -> NeuralDynamics:
    """The network-only baseline; it knows nothing of the swimmer."""
    del known
    return paper_black_box(jax.random.key(seed))


def default_ude(known: Swimmer, seed: int, data: dict[str, Any]) -> Swimmer:
    """The paper's network on standardised (x, y, t), its weights spread."""
    environment = paper_force(jax.random.key(seed))
    center, scale = data["mean"], data["std"]
    inputs = [0, 1, len(center) - 1]
    features = PositionTimeFeatures(
        tuple(center[i] for i in inputs), tuple(scale[i] for i in inputs)
    )
    environment = NeuralForce(spread_weights(environment.network), features)
    return eqx.tree_at(lambda swimmer: swimmer.environment, known, environment)


def default_nn_only(known: Swimmer, seed: int, data: dict[str, Any]) -> NeuralDynamics:
    """The black box on standardised (x, y, vx, vy, t), its weights spread."""
    del known
    network = spread_weights(paper_black_box(jax.random.key(seed)).network)
    return NeuralDynamics(network, tuple(data["mean"]), tuple(data["std"]))


def default_kernel(known: Swimmer, seed: int | None, data: dict[str, Any]) -> Swimmer:
    """A kernel potential around the data, zero before training; it has no seed."""
    del seed
    environment = kernel_potential(np.asarray(data["positions"]))
    return eqx.tree_at(lambda swimmer: swimmer.environment, known, environment)


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


CONSTANTS: dict[str, Callable[[Any], Any]] = {
    "damping": lambda swimmer: swimmer.drag.damping,
    "gain": lambda swimmer: swimmer.propulsion.gain,
}
"""Known constants that `pinav fit --learn` can train."""


def residual(model: Any) -> Any:
    """The learned part of a model: what trains unless more is asked for."""
    learned: Any = model.environment if isinstance(model, Swimmer) else model
    return learned.parameters


def fit_model(settings: FitSettings, known: Swimmer, data: dict[str, Any]) -> Any:
    """The untrained model of `pinav fit`, its inputs standardised by the data.

    Args:
        settings: its kind, size and seed.
        known: swimmer whose propulsion and drag are known.
        data: moments of the data, from `data_moments`.
    """
    if settings.model == "ude-kernel":
        return default_kernel(known, None, data)
    mean, std = data["mean"], data["std"]
    dim = len(mean) // 2
    inputs = {
        "ude": (*range(dim), len(mean) - 1),
        "ude-static": tuple(range(dim)),
        "nn-only": tuple(range(len(mean))),
    }
    chosen = inputs[settings.model]
    center, scale = tuple(mean[i] for i in chosen), tuple(std[i] for i in chosen)
    outputs = 2 * dim if settings.model == "nn-only" else dim
    key = jax.random.key(settings.seed)
    network = spread_weights(
        tanh_network(
            len(chosen), outputs, width=settings.width, depth=settings.depth, key=key
        )
    )
    if settings.model == "nn-only":
        return NeuralDynamics(network, center, scale)
    kind = PositionFeatures if settings.model == "ude-static" else PositionTimeFeatures
    environment = NeuralForce(network, kind(center, scale))
    return eqx.tree_at(lambda swimmer: swimmer.environment, known, environment)


def fit_trainable(settings: FitSettings) -> Trainable:
    """Selects the leaves that `pinav fit` trains."""
    chosen = [CONSTANTS[name] for name in settings.learn]
    return lambda model: (residual(model), *(pick(model) for pick in chosen))


def data_moments(trajectories: Trajectories) -> dict[str, list]:
    """Mean and standard deviation of each state and of time, and the positions."""
    complete = trajectories.observed.all(-1)
    times = trajectories.times[complete][:, None]
    rows = np.concatenate([trajectories.states[complete], times], axis=1)
    std = rows.std(axis=0)
    return {
        "mean": rows.mean(axis=0).tolist(),
        "std": np.where(std > 0, std, 1.0).tolist(),
        "positions": trajectories.states[complete][:, :2].tolist(),
    }


def known_physics(name: str | None, trajectories: Trajectories) -> Scenario:
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
