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
    paper_force,
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


PAPER_MODELS = {"ude": paper_ude, "nn-only": paper_nn_only}
"""Models that the paper trains, by the name of their row in Table 2."""


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
    """The untrained model of `pinav fit`.

    Args:
        settings: its kind, size and seed.
        known: swimmer whose propulsion and drag are known.
        data: centre and scale of the data, from `data_scales`.
    """
    key = jax.random.key(settings.seed)
    center, scale = tuple(data["center"]), tuple(data["scale"])
    dim = len(center) // 2
    size = {"width": settings.width, "depth": settings.depth, "key": key}
    if settings.model == "nn-only":
        network = tanh_network(2 * dim + 1, 2 * dim, **size)
        return NeuralDynamics(network, center, scale)
    if settings.model == "ude-static":
        features = PositionFeatures(center[:dim], scale[:dim])
    else:
        features = PositionTimeFeatures(
            (*center[:dim], center[-1]), (*scale[:dim], scale[-1])
        )
    network = tanh_network(len(features.center), dim, **size)
    environment = NeuralForce(network, features)
    return eqx.tree_at(lambda swimmer: swimmer.environment, known, environment)


def fit_trainable(settings: FitSettings) -> Trainable:
    """Selects the leaves that `pinav fit` trains."""
    chosen = [CONSTANTS[name] for name in settings.learn]
    return lambda model: (residual(model), *(pick(model) for pick in chosen))


def data_scales(trajectories: Trajectories) -> dict[str, list[float]]:
    """Middle and half-width of each state, and of time, over the observed samples."""
    low, high = [], []
    for channel in range(len(trajectories.channels)):
        values = trajectories.states[..., channel][trajectories.observed[..., channel]]
        low.append(values.min())
        high.append(values.max())
    low.append(trajectories.times.min())
    high.append(trajectories.times.max())
    half = (np.array(high) - np.array(low)) / 2
    center = (np.array(high) + np.array(low)) / 2
    return {"center": center.tolist(), "scale": np.where(half > 0, half, 1.0).tolist()}


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
        known = scenario(header["physics"]).truth
        if header["kind"] == "paper":
            model = PAPER_MODELS[header["name"]](known, header["seed"])
        else:
            settings = FitSettings(**header["settings"])
            model = fit_model(settings, known, header["data"])
        return with_dtype(model, jnp.dtype(header["dtype"]))
    except (KeyError, TypeError) as error:
        raise InputError(
            f"model file: its first line misses or misnames {error}"
        ) from error
