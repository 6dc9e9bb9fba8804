"""The learned force at every observed position, as tables for viewers of tracks."""

import csv
import io
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from pinav.dynamics import with_dtype
from pinav.errors import InputError
from pinav.fitting import Posterior
from pinav.forces import AbstractForce, as_learned_force, forces_at
from pinav.learning.learned import Learned
from pinav.trajectories import POSITION_CHANNELS
from pinav.units import force_unit


class SpotTable(NamedTuple):
    """The observed positions of all trajectories, and the learned force there.

    Attributes:
        trajectory: to which each spot belongs, counted from 0.
        frame: its place in the trajectory, counted from 0; frames without an observed
            position are counted and left out.
        time: [T].
        position: as observed [L].
        force: learned force on a swimmer at rest there.
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
    """The learned force at the observed positions of the data that were fitted.

    Raises:
        InputError: the run holds several models, or one that learned no force.
    """
    data = run.data
    is_observed = data.observed[..., : data.dim].all(axis=-1)
    is_observed &= np.arange(data.times.shape[1]) < data.lengths[:, None]
    trajectory, frame = np.nonzero(is_observed)
    position, time = data.positions[is_observed], data.times[is_observed]
    force = learned_force(run)
    values = exact_forces(force, position, time)
    sd = force_sds(run.posterior, force, position, time)
    return SpotTable(trajectory, frame, time, position, values, sd, result_units(run))


def learned_force(run: Learned) -> AbstractForce:
    """The force that stands for the unknown in the model of a run.

    Raises:
        InputError: the run holds several models, or one without such a force.
    """
    force = getattr(run.model, "environment", None)
    if not isinstance(force, AbstractForce):
        raise InputError(
            f"{run.folder.path}: model {run.choice.name} learned no force; fit one "
            "with a potential or a force, such as --model kernel-potential"
        )
    return force


def exact_forces(
    force: AbstractForce,
    positions: Float[np.ndarray, "spot dim"],
    times: Float[np.ndarray, " spot"],
) -> Float[np.ndarray, "spot dim"]:
    """The force on a swimmer at rest at each position and time."""
    with jax.enable_x64(new_val=True):
        exact = with_dtype(force, jnp.float64)
        return np.asarray(forces_at(exact, times, positions))


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
    return _csv([heads], columns)


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
    return _csv(list(zip(*features, strict=True)), columns)


def _csv(heads: list, columns: list) -> str:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerows(heads)
    writer.writerows(zip(*(_cells(column) for column in columns), strict=True))
    return stream.getvalue()


def _cells(column: np.ndarray | list[str]) -> list:
    """Numbers with all of their digits; nothing where there is none."""
    cells = column.tolist() if isinstance(column, np.ndarray) else column
    return ["" if cell != cell else cell for cell in cells]
