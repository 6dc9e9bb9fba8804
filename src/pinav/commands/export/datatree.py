"""A run as a tree of datasets, as xarray holds it and ArviZ 1 reads it."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jaxtyping import Float

from pinav.commands.export.spots import (
    exact_forces,
    force_sds,
    learned_force,
    result_units,
)
from pinav.errors import InputError
from pinav.evaluation import extent, require_x64
from pinav.fitting import Posterior
from pinav.fitting.engine.constant_priors import parameter_names
from pinav.forces import AbstractForce
from pinav.learning.learned import Learned
from pinav.trajectories import POSITION_CHANNELS

if TYPE_CHECKING:
    from xarray import Dataset, DataTree

MISSING = "{} is not installed; install it by pip install 'pinav[exchange]'"

Variable = tuple[Any, ...]
"""Dimensions, values and attributes of a variable of a dataset."""

CHAIN = ("chain", "draw")
"""Dimensions with which ArviZ begins those of every drawn variable."""


def datatree_of(
    run: Learned, *, draws: int = 100, points: int = 41, seed: int = 0
) -> "DataTree":
    """The posterior of a run, what it predicts, and the data that it was fitted to.

    Groups, by the schema of ArviZ:

    - `posterior`: draws of all parameters by the paths of their leaves, and of each
      learned constant by its name.
    - `predictions`: the force on a swimmer at rest on a grid around the data, at the
      first time of the data: its mean, standard deviation and the same draws.
    - `observed_data`: positions and velocities, NaN where they were not observed.
    - `constant_data`: times and commands.

    The draws are independent draws from the normal (Laplace) posterior, one chain. A
    run without a posterior has the mean of the force and the data alone.

    Args:
        run: of a fit.
        draws: from the posterior.
        points: of the grid along the longest side of the data.
        seed: of the draws.

    Raises:
        InputError: xarray is not installed, the run learned no force, or x64 is
            switched off.
    """
    require_x64("drawing from a posterior")
    try:
        from xarray import DataTree
    except ImportError as error:
        raise InputError(MISSING.format("xarray")) from error
    samples, groups = [], _data(run)
    if run.posterior is not None:
        key = jax.random.key(seed)
        theta = np.asarray(run.posterior.draws(draws, key=key))
        paths = {name: name for name in run.constants} | run.choice.paths()
        groups["posterior"] = _posterior(run.posterior, theta, paths)
        # of the same key, thus of the same parameters
        samples = [one.environment for one in run.posterior.samples(draws, key=key)]
    groups["predictions"] = _predictions(run, points, samples)
    tree = DataTree.from_dict({f"/{name}": data for name, data in groups.items()})
    tree.attrs.update(
        inference_library="pinav",
        creation_command="pinav export",
        system=run.system.name,
        model=run.choice.name,
        posterior="independent draws from the Laplace approximation",
    )
    return tree


def _posterior(
    posterior: Posterior,
    draws: Float[np.ndarray, "draw parameter"],
    constants: Mapping[str, str],
) -> "Dataset":
    """The draws: all parameters by the paths of their leaves, constants by name."""
    from xarray import Dataset

    names = parameter_names(posterior.free, len(posterior.mean))
    variables: dict[str, Variable] = {
        "parameters": ((*CHAIN, "parameter"), draws[None])
    }
    for name, path in constants.items():
        if path in names:
            variables[name] = (CHAIN, draws[None, :, names.index(path)])
    coordinates = {"chain": [0], "draw": np.arange(len(draws))}
    return Dataset(variables, {**coordinates, "parameter": list(names)})


def _predictions(
    run: Learned, points: int, samples: Sequence[AbstractForce]
) -> "Dataset":
    """The force on a grid around the data."""
    from xarray import Dataset

    force, posterior = learned_force(run), run.posterior
    axes, along = POSITION_CHANNELS[: run.data.dim], _grid(run, points)
    grid = np.stack(np.meshgrid(*along, indexing="ij"), axis=-1)
    places = grid.reshape(-1, len(axes))
    moments = np.full(len(places), float(run.data.times[0, 0]))
    length, _, unit = result_units(run)
    dims, units = (*axes, "axis"), {"units": unit}
    mean = exact_forces(force, places, moments).reshape(grid.shape)
    variables: dict[str, Variable] = {"force_mean": (dims, mean, units)}
    if posterior is not None:
        sd = force_sds(posterior, force, places, moments).reshape(grid.shape)
        drawn = np.stack([exact_forces(one, places, moments) for one in samples])
        shape = (1, len(samples), *grid.shape)
        variables["force_sd"] = (dims, sd, units)
        variables["force"] = ((*CHAIN, *dims), drawn.reshape(shape), units)
    coordinates = {
        name: (name, x, {"units": length}) for name, x in zip(axes, along, strict=True)
    }
    return Dataset(variables, {**coordinates, "axis": list(axes)})


def _grid(run: Learned, points: int) -> list[Float[np.ndarray, " point"]]:
    """Coordinates of a grid over the box of the data, equally spaced."""
    data = run.data
    is_observed = data.positions[data.observed[..., : data.dim].all(axis=-1)]
    low, high = is_observed.min(axis=0), is_observed.max(axis=0)
    spacing = extent(data) / (points - 1)
    counts = np.maximum(np.ceil((high - low) / spacing).astype(int), 1) + 1
    return [np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True)]


def _data(run: Learned) -> "dict[str, Dataset]":
    """What was observed, and when, under which commands."""
    from xarray import Dataset

    data = run.data
    rows = ("trajectory", "sample")
    within = np.arange(data.times.shape[1]) < data.lengths[:, None]
    observed = {
        name: (
            rows,
            np.where(data.observed[..., i], data.states[..., i], np.nan),
            {"units": data.units[name]},
        )
        for i, name in enumerate(data.channels)
    }
    constant = {
        name: (rows, np.where(within, values, np.nan), {"units": data.units[name]})
        for name, values in {"t": data.times, **data.commands}.items()
    }
    return {"observed_data": Dataset(observed), "constant_data": Dataset(constant)}
