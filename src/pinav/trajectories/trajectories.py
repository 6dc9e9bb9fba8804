"""`Trajectories`: what was observed of one or more swimmers, and when.

The one data type of the package. Simulated scenarios and recordings become
`Trajectories`; fits, evaluation and reports take nothing else.
"""

import dataclasses
import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float64, Int64

from pinav.errors import InputError
from pinav.trajectories.trajectory import (
    Ragged,
    Trajectory,
    arrays_per_trajectory,
    check_trajectory,
    split_headings,
    table_columns,
)

UNKNOWN_UNIT = "?"
"""Unit of a channel whose unit nobody stated; "1" means dimensionless."""

POSITION_CHANNELS = ("x", "y", "z")
"""Channels that are coordinates; they come before all others."""


class Trajectories(eqx.Module):
    """Observed trajectories of different lengths, as padded host arrays.

    Build it with `from_arrays`, which checks; all arrays are read-only NumPy arrays
    in float64 whatever the mode of JAX. Padding stands at the end: the last time, the
    last state and the last command repeat, and nothing is observed.

    Attributes:
        times: increasing within a trajectory [T].
        states: 0 where not observed, never NaN.
        observed: mask of the observed entries of `states`.
        lengths: samples of each trajectory before its padding.
        commands: commands of the operator at each time, by name.
        units: unit of each channel, of each command and of time `t`.
    """

    times: Float64[np.ndarray, "trajectory time"]
    states: Float64[np.ndarray, "trajectory time state"]
    observed: Bool[np.ndarray, "trajectory time state"]
    lengths: Int64[np.ndarray, " trajectory"]
    commands: dict[str, Float64[np.ndarray, "trajectory time"]]
    channels: tuple[str, ...] = eqx.field(static=True)
    units: dict[str, str]
    provenance: dict[str, Any]

    @classmethod
    def from_arrays(
        cls,
        times: Ragged,
        states: Ragged,
        *,
        channels: Sequence[str],
        observed: Ragged | None = None,
        commands: Mapping[str, Ragged] | None = None,
        units: Mapping[str, str] | None = None,
        provenance: Mapping[str, Any] | None = None,
    ) -> "Trajectories":
        """Trajectories from the arrays of one, or from a sequence with those of each.

        Args:
            times: a vector for each trajectory, or one vector that all share [T].
            states: a table (time, state) for each trajectory.
            observed: mask shaped as `states`, all true by default; unobserved entries
                may be NaN.
            commands: vectors of numbers by name, shaped as `times`.
            units: unit of any channel, command or `t`; "?" where not stated.

        Raises:
            InputError: the arrays do not fit together, are not finite, or a time does
                not come after the one before it.
        """
        commands = dict(commands or {})
        channels = check_names(channels, commands)
        tables = arrays_per_trajectory("states", states, 2)
        vectors = arrays_per_trajectory("times", times, 1, len(tables))
        masks = [None] * len(tables)
        if observed is not None:
            masks = arrays_per_trajectory("observed", observed, 2, len(tables), bool)
        named = {
            name: arrays_per_trajectory(f"command {name!r}", values, 1, len(tables))
            for name, values in commands.items()
        }
        pieces = [
            check_trajectory(
                f"trajectory {i}",
                channels,
                (vectors[i], tables[i], masks[i]),
                {name: values[i] for name, values in named.items()},
            )
            for i in range(len(tables))
        ]
        units = _all_units(units or {}, (*channels, "t", *commands))
        return cls.from_pieces(pieces, channels, units, provenance or {})

    @classmethod
    def from_pieces(
        cls,
        pieces: Sequence[Trajectory],
        channels: tuple[str, ...],
        units: Mapping[str, str],
        provenance: Mapping[str, Any],
    ) -> "Trajectories":
        """Trajectories that were checked before, padded no more than needed."""
        return cls(
            times=_pad([piece.times for piece in pieces]),
            states=_pad([piece.states for piece in pieces]),
            observed=_pad([piece.observed for piece in pieces], mode="constant"),
            lengths=read_only(np.array([len(p.times) for p in pieces], np.int64)),
            commands={
                name: _pad([piece.commands[name] for piece in pieces])
                for name in pieces[0].commands
            },
            channels=channels,
            units=dict(units),
            provenance=_as_json(provenance),
        )

    @classmethod
    def from_table(
        cls,
        table: Any,
        *,
        commands: Sequence[str] = (),
        units: Mapping[str, str] | None = None,
        provenance: Mapping[str, Any] | None = None,
    ) -> "Trajectories":
        """Trajectories from a table with a column `t` and one for each channel.

        A column `trajectory` tells the rows of several apart. What is missing (NaN,
        None, a null) was not observed. A heading may state a unit: `x [um]`.

        Args:
            table: of pandas, polars, pyarrow or any package with the Arrow stream
                protocol, or a mapping of columns.
            commands: names of the columns that hold commands.
            units: unit of any channel, command or `t`, overriding the headings.

        Raises:
            InputError: it is no such table, or its numbers do not fit together.
        """
        columns = table_columns(table)
        names, stated = split_headings(list(columns))
        columns = dict(zip(names, columns.values(), strict=True))
        for name in ("t", *commands):
            if name not in columns:
                raise InputError(
                    f"from_table: column {name!r} is missing; got {', '.join(names)}"
                )
        label = columns.pop("trajectory", np.zeros(len(columns["t"])))
        _, first = np.unique(label, return_index=True)
        groups = [np.flatnonzero(label == label[row]) for row in np.sort(first)]
        channels = tuple(name for name in columns if name not in ("t", *commands))
        states = np.stack([columns[name] for name in channels or ("t",)], axis=1)
        return cls.from_arrays(
            [columns["t"][rows] for rows in groups],
            [states[rows] for rows in groups],
            channels=channels,
            observed=[np.isfinite(states[rows]) for rows in groups],
            commands={
                name: [columns[name][rows] for rows in groups] for name in commands
            },
            units={**stated, **(units or {})},
            provenance=provenance,
        )

    def to_table(self) -> dict[str, np.ndarray]:
        """Columns `trajectory`, `t`, channels (NaN if unobserved) and commands."""
        pieces = list(self)
        states = np.concatenate(
            [np.where(piece.observed, piece.states, np.nan) for piece in pieces]
        )
        return {
            "trajectory": np.repeat(np.arange(len(self)), self.lengths),
            "t": np.concatenate([piece.times for piece in pieces]),
            **dict(zip(self.channels, states.T, strict=True)),
            **{
                name: np.concatenate([piece.commands[name] for piece in pieces])
                for name in self.commands
            },
        }

    def __len__(self) -> int:
        """Number of trajectories."""
        return len(self.lengths)

    def __iter__(self) -> Iterator[Trajectory]:
        """Each trajectory without its padding."""
        return map(self.trajectory, range(len(self)))

    @property
    def spread(self) -> float:
        """Standard deviation of all observed numbers together; 1 where it is zero."""
        return float(np.std(self.states[self.observed])) or 1.0

    @property
    def num_observed(self) -> int:
        """Number of observed values, all trajectories and channels together."""
        return int(self.observed.sum())

    @property
    def dim(self) -> int:
        """Number of channels that are coordinates: x, y, z."""
        return sum(name in POSITION_CHANNELS for name in self.channels)

    @property
    def positions(self) -> Float64[np.ndarray, "trajectory time dim"]:
        """The coordinates among the states, which come first."""
        return self.states[..., : self.dim]

    @property
    def seen(self) -> Bool[np.ndarray, "trajectory time"]:
        """Where all coordinates were observed; nowhere in the padding."""
        return np.all(self.observed[..., : self.dim], axis=-1)

    @property
    def seen_positions(self) -> Float64[np.ndarray, "sample dim"]:
        """The positions that were observed, of one trajectory after the other [L]."""
        return self.positions[self.seen]

    def only(self, channels: Sequence[str]) -> "Trajectories":
        """The trajectories with these channels alone, in this order.

        Raises:
            InputError: a channel is not there.
        """
        for name in channels:
            if name not in self.channels:
                raise InputError(
                    f"channel {name!r}: expected some of {', '.join(self.channels)}"
                )
        columns = [self.channels.index(name) for name in channels]
        units = {
            name: unit
            for name, unit in self.units.items()
            if name in channels or name not in self.channels
        }
        return dataclasses.replace(
            self,
            states=read_only(self.states[..., columns]),
            observed=read_only(self.observed[..., columns]),
            channels=tuple(channels),
            units=units,
        )

    def trajectory(self, index: int) -> Trajectory:
        """The trajectory at `index` without its padding; a view, not a copy."""
        index = _check_indices([index], len(self))[0]
        rows = slice(self.lengths[index])
        return Trajectory(
            times=self.times[index, rows],
            states=self.states[index, rows],
            observed=self.observed[index, rows],
            commands={name: c[index, rows] for name, c in self.commands.items()},
        )

    def select(self, indices: Sequence[int] | np.ndarray) -> "Trajectories":
        """The trajectories at `indices`, in that order, padded no more than needed.

        The provenance remembers, as `selection`, where each of them stood at first.
        """
        chosen = _check_indices(indices, len(self))
        before = self.provenance.get("selection", range(len(self)))
        selection = [before[i] for i in chosen]
        provenance = self.provenance | {"selection": selection}
        pieces = [self.trajectory(i) for i in chosen]
        return self.from_pieces(pieces, self.channels, self.units, provenance)


def check_names(
    channels: Sequence[str], commands: Mapping[str, Any]
) -> tuple[str, ...]:
    """The channels, when they and the commands can be the columns of a table.

    Raises:
        InputError: they cannot; the message names the channel.
    """
    if isinstance(channels, str) or not channels:
        raise InputError(
            f"channels: expected names such as ('x', 'y'), got {channels!r}"
        )
    names = (*channels, *commands)
    for name in names:
        if not (isinstance(name, str) and name and name.isprintable()):
            raise InputError(f"channels: expected printable names, got {name!r}")
        if name != name.strip() or name[0] == "#" or name in ("t", "trajectory"):
            raise InputError(
                f"channel {name!r}: expected no space or # at its ends and neither "
                "'t' nor 'trajectory', which name other columns; rename it"
            )
        if names.count(name) > 1:
            raise InputError(f"channel {name!r}: stands twice in {names}; rename one")
    return tuple(channels)


def _all_units(units: Mapping[str, str], names: Sequence[str]) -> dict[str, str]:
    for name in units:
        if name not in names:
            raise InputError(
                f"units: {name!r} is no channel; expected some of {', '.join(names)}"
            )
    return {name: str(units.get(name, UNKNOWN_UNIT)) for name in names}


def _check_indices(indices: Sequence[int] | np.ndarray, count: int) -> list[int]:
    """The indices as integers from 0, negative ones counted from the end."""
    chosen = np.asarray(indices)
    if chosen.ndim != 1 or chosen.size == 0 or chosen.dtype.kind not in "iu":
        raise InputError(
            f"trajectories: expected one or more whole numbers, got {indices!r}"
        )
    for index in chosen:
        if not -count <= index < count:
            raise InputError(f"trajectory {index}: there are {count}, counted from 0")
    return (chosen % count).tolist()


def _pad(
    arrays: Sequence[np.ndarray], mode: Literal["edge", "constant"] = "edge"
) -> np.ndarray:
    """The arrays stacked; short ones repeat their last row, or get zeros."""
    longest = max(map(len, arrays))
    padded = [
        np.pad(a, [(0, longest - len(a))] + [(0, 0)] * (a.ndim - 1), mode)
        for a in arrays
    ]
    return read_only(np.stack(padded))


def read_only(array: np.ndarray) -> np.ndarray:
    """The array, which nothing can write to any more."""
    array.setflags(write=False)
    return array


def _as_json(provenance: Mapping[str, Any]) -> dict[str, Any]:
    """A copy as a JSON file would give it back."""
    try:
        return json.loads(json.dumps(dict(provenance), allow_nan=False))
    except (TypeError, ValueError) as error:
        raise InputError(f"provenance: expected JSON values: {error}") from error
