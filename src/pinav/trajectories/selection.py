"""Parts of trajectories, several put together, and channels that nobody observed."""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int, PRNGKeyArray

from pinav.errors import InputError
from pinav.settings import FRACTION
from pinav.systems import System, velocity_unit
from pinav.trajectories.trajectories import Trajectories, check_names, read_only


def with_missing_channels(
    trajectories: Trajectories, units: Mapping[str, str]
) -> Trajectories:
    """The trajectories with further unobserved channels, by their units.

    A tracker gives positions; a swimmer with inertia has velocities too.
    """
    channels = check_names((*trajectories.channels, *units), trajectories.commands)
    blank = np.zeros((*trajectories.times.shape, len(units)))
    states = np.concatenate([trajectories.states, blank], axis=2)
    observed = np.concatenate([trajectories.observed, blank > 0], axis=2)
    return dataclasses.replace(
        trajectories,
        states=read_only(states),
        observed=read_only(observed),
        channels=channels,
        units={**trajectories.units, **units},
    )


def with_all_channels(data: Trajectories, system: System) -> Trajectories:
    """The data; positions alone get velocities that nobody observed."""
    positions = system.position_channels
    if data.channels != positions:
        return data
    unseen = system.channels[len(positions) :]
    return with_missing_channels(data, {name: system.units[name] for name in unseen})


def with_velocities(trajectories: Trajectories) -> Trajectories:
    """The trajectories of positions alone with velocities that nobody observed."""
    if trajectories.dim != len(trajectories.channels):
        return trajectories
    length, time = (
        trajectories.units[name] for name in (trajectories.channels[0], "t")
    )
    unit = velocity_unit(length, time)
    units = {f"v{name}": unit for name in trajectories.channels}
    return with_missing_channels(trajectories, units)


class Split(NamedTuple):
    """Trajectories for training, and those kept for testing."""

    train: Trajectories
    held_out: Trajectories


def split(trajectories: Trajectories, fraction: float, *, key: PRNGKeyArray) -> Split:
    """Split by whole trajectories, at random.

    Args:
        fraction: training share between 0 and 1, rounded so that neither part is empty.

    Raises:
        InputError: there is one trajectory, or `fraction` is not between 0 and 1.
    """
    count = len(trajectories)
    FRACTION.check("split fraction", fraction)
    if count < 2:
        raise InputError("split: expected two or more trajectories, got 1")
    num_train = min(max(round(fraction * count), 1), count - 1)
    order = np.asarray(jax.random.permutation(key, count))
    train, held_out = np.sort(order[:num_train]), np.sort(order[num_train:])
    return Split(trajectories.select(train), trajectories.select(held_out))


def halve(trajectories: Trajectories, least: int) -> Trajectories:
    """Each trajectory as two, one after the other, of half of its samples.

    Args:
        least: samples of a half; shorter trajectories stay whole.
    """
    pieces = []
    for whole in trajectories:
        middle = len(whole.times) // 2
        ends = (middle, len(whole.times)) if middle >= least else (len(whole.times),)
        for first, end in itertools.pairwise((0, *ends)):
            part = slice(first, end)
            pieces.append(jax.tree.map(lambda rows, part=part: rows[part], whole))
    return Trajectories.from_pieces(
        pieces, trajectories.channels, trajectories.units, trajectories.provenance
    )


def join_halves(
    states: Float[np.ndarray, "half sample state"],
    trajectories: Trajectories,
    least: int,
) -> Float[np.ndarray, "trajectory time state"]:
    """States of trajectories from those of their halves; see `halve`."""
    halves = iter(zip(states, halve(trajectories, least).lengths, strict=True))
    joined = np.zeros((*trajectories.times.shape, states.shape[-1]))
    for row, length in zip(joined, trajectories.lengths, strict=True):
        filled = 0
        while filled < length:
            half, count = next(halves)
            row[filled : filled + count] = half[:count]
            filled += count
        row[length:] = row[length - 1]
    return joined


def concatenate(several: Sequence[Trajectories]) -> Trajectories:
    """The trajectories of all, in order; provenances are kept side by side.

    Raises:
        InputError: there is nothing to join, or channels, commands or units differ.
    """
    if not several:
        raise InputError("concatenate: expected one or more Trajectories, got none")
    first = several[0]
    for other in several[1:]:
        for name in ("channels", "units"):
            expected, got = getattr(first, name), getattr(other, name)
            if expected != got:
                raise InputError(
                    f"concatenate: {name} differ, {expected} and {got}; "
                    "bring them to one form first"
                )
    provenance = {"concatenated": [part.provenance for part in several]}
    pieces = [piece for part in several for piece in part]
    return Trajectories.from_pieces(pieces, first.channels, first.units, provenance)


def informative_samples(
    trajectories: Trajectories, most: int
) -> Int[np.ndarray, "sample 2"]:
    """Trajectory and sample of at most `most`, dense where states change fast."""
    counted = np.arange(trajectories.states.shape[1]) < trajectories.lengths[:, None]
    counted[:, 0] = False
    return np.argwhere(counted)[informative_rows(trajectories.states[counted], most)]


def informative_rows(
    states: Float[np.ndarray, "sample state"], most: int
) -> Int[np.ndarray, " row"]:
    """At most `most` rows of a table: half evenly in time, half along the path.

    The length of the path is that of the standardised states.
    """
    count = len(states)
    if count <= most:
        return np.arange(count)
    spread = states.std(axis=0)
    scaled = states / np.where(spread > 0, spread, 1.0)
    lengths = np.linalg.norm(np.diff(scaled, axis=0, prepend=scaled[:1]), axis=1)
    fractions = lengths / max(lengths.sum(), np.finfo(float).tiny)
    passed = np.cumsum(0.5 / count + 0.5 * fractions)
    parts = np.ceil(most * (passed / passed[-1]))  # from 1 to `most`: the last is exact
    return np.flatnonzero(np.diff(parts, prepend=0.0) > 0)
