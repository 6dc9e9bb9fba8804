"""`pinav export`: what a run has learned, in the formats of other programs."""

import importlib.util
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from pinav.commands.command import CommandResult
from pinav.commands.export import ExportOptions
from pinav.commands.results import open_fit
from pinav.errors import InputError
from pinav.evaluation import exact_forces, extent, require_x64
from pinav.files import atomic_write, check_destination, csv_text
from pinav.fitting import Posterior
from pinav.fitting.engine.local_model import parameter_names
from pinav.forces import AbstractForce, as_learned_force
from pinav.learning.learned import Learned
from pinav.trajectories import POSITION_CHANNELS
from pinav.units import force_unit

if TYPE_CHECKING:
    from xarray import Dataset, DataTree


class SpotTable(NamedTuple):
    """The observed positions of all trajectories, and the learned force there.

    Attributes:
        trajectory: to which each spot belongs, counted from 0.
        frame: its place in the trajectory, counted from 0; frames without an observed
            position are counted and left out.
        time: [T].
        position: as observed [L].
        force_sd: its standard deviation along each axis; NaN without a posterior.
        units: of position, time and force; "?" where not stated.
    """

    trajectory: Int[np.ndarray, " spot"]
    frame: Int[np.ndarray, " spot"]
    time: Float[np.ndarray, " spot"]
    position: Float[np.ndarray, "spot dim"]
    force: Float[np.ndarray, "spot dim"]
    force_sd: Float[np.ndarray, "spot dim"]
    units: tuple[str, str, str]


def spot_table(run: Learned) -> SpotTable:
    """The learned force at the observed positions of the data that were fitted."""
    data = run.data
    trajectory, frame = np.nonzero(data.seen)
    position, time = data.seen_positions, data.times[data.seen]
    force = learned_force(run)
    values = exact_forces(force, position, time)
    sd = force_sds(run.posterior, force, position, time)
    return SpotTable(trajectory, frame, time, position, values, sd, result_units(run))


def learned_force(run: Learned) -> AbstractForce:
    """The force that stands for the unknown in the model of a run."""
    force = getattr(run.model, "environment", None)
    if not isinstance(force, AbstractForce):
        raise InputError(
            f"{run.folder.path}: model {run.choice.name} learned no force; fit one "
            "with a potential or a force, such as --model kernel-potential"
        )
    return force


def force_sds(
    posterior: Posterior | None,
    force: AbstractForce,
    positions: Float[np.ndarray, "spot dim"],
    times: Float[np.ndarray, " spot"],
) -> Float[np.ndarray, "spot dim"]:
    """Standard deviation of the force at each of them; NaN without a posterior."""
    sd = np.full_like(positions, np.nan)
    if posterior is None:
        return sd
    learned = as_learned_force(force)
    static = learned is None or learned.is_static
    moments = np.zeros_like(times) if static else times
    for moment in np.unique(moments):
        rows = moments == moment
        sd[rows] = posterior.force_sd(positions[rows], float(moment))
    return sd


def result_units(run: Learned) -> tuple[str, str, str]:
    """Units of length, time and the learned force; "?" where not stated."""
    return run.units["x"], run.units["t"], force_unit(run.units)


def napari_csv(table: SpotTable) -> str:
    """A tracks layer of napari: ID, T, (Z,) Y, X, then the properties of each spot.

    T is the frame, because napari wants whole numbers there; lengths are those of the
    data.
    """
    dim = table.position.shape[1]
    axes = POSITION_CHANNELS[:dim]
    heads = ["ID", "T", *(name.upper() for name in reversed(axes)), "time"]
    heads += [f"force_{name}" for name in axes] + ["force"]
    heads += [f"force_{name}_sd" for name in axes]
    columns = [table.trajectory, table.frame, *table.position.T[::-1], table.time]
    columns += [*table.force.T, np.linalg.norm(table.force, axis=1), *table.force_sd.T]
    return csv_text([heads, *zip(*columns, strict=True)])


def trackmate_csv(table: SpotTable) -> str:
    """Spots as TrackMate 7 exports them: names, two rows of words, units, spots."""
    dim = table.position.shape[1]
    length, time, force = (f"({unit})" for unit in table.units)
    axes = POSITION_CHANNELS[:dim]
    features = [
        ("LABEL", "Label", "Label", ""),
        ("ID", "Spot ID", "Spot ID", ""),
        ("TRACK_ID", "Track ID", "Track ID", ""),
        *((f"POSITION_{a}".upper(), a.upper(), a.upper(), length) for a in axes),
        ("POSITION_T", "T", "T", time),
        ("FRAME", "Frame", "Frame", ""),
        *((f"FORCE_{a}".upper(), f"Force {a}", f"F{a}", force) for a in axes),
        ("FORCE", "Force", "F", force),
        *((f"FORCE_{a}_SD".upper(), f"Sd force {a}", f"sd F{a}", force) for a in axes),
    ]
    spots = np.arange(len(table.time))
    columns = [[f"ID{i}" for i in spots], spots, table.trajectory]
    columns += [*table.position.T, table.time, table.frame, *table.force.T]
    columns += [np.linalg.norm(table.force, axis=1), *table.force_sd.T]
    return csv_text([*zip(*features, strict=True), *zip(*columns, strict=True)])


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
    low, high = data.seen_positions.min(axis=0), data.seen_positions.max(axis=0)
    spacing = extent(data) / (points - 1)
    counts = np.maximum(np.ceil((high - low) / spacing).astype(int), 1) + 1
    return [np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True)]


def _data(run: Learned) -> "dict[str, Dataset]":
    """Observations with their times and commands."""
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


def run(options: ExportOptions) -> CommandResult:
    """Write one file."""
    check_destination(options.out, overwrite=options.overwrite)
    fit = open_fit(options.run)
    table = spot_table(fit)
    content = _content(fit, table, options)
    atomic_write(options.out, lambda f: f.write(content), overwrite=options.overwrite)
    spots = len(table.time)
    written = {"file": str(options.out), "format": options.to, "spots": spots}
    return CommandResult(written, f"{options.out}: {spots} spots, {options.to}")


def _content(fit: Learned, table: SpotTable, options: ExportOptions) -> bytes:
    """The bytes of the file."""
    if options.to == "napari":
        return napari_csv(table).encode()
    if options.to == "trackmate":
        return trackmate_csv(table).encode()
    if importlib.util.find_spec("h5netcdf") is None:
        raise InputError(MISSING.format("h5netcdf"))
    tree = datatree_of(
        fit, draws=options.draws, points=options.points, seed=options.seed
    )
    return bytes(tree.to_netcdf(engine="h5netcdf"))
