"""Tracks: one robot of one run, its segments padded and cut into blocks.

A rolling robot wobbles at its rolling frequency, by micrometres, and cameras alias
that. What is predicted here are seconds, not frames: likelihoods see the mean position
of each block of time, in which the wobble averages out.
"""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from pinav.errors import InputError
from pinav.samples import Trajectory
from pinav.trajectories import Trajectories

BLOCK = 0.5
"""Length of a block at most [s]: long against frames, short against what is predicted.

At 0.3 s wobble leaks into the likelihood, at 1 s delays are lost (docs)."""

BLOCKS_AT_LEAST = 60
"""Shorter recordings are cut into shorter blocks, so that there are about as many."""


class Track(eqx.Module):
    """One robot of one run; never integrated across its segments.

    Attributes:
        name: run and particle.
        pieces: the segments, without padding.
        width: length of a block [s].
    """

    name: str = eqx.field(static=True)
    pieces: tuple[Trajectory, ...]
    width: float = eqx.field(static=True)

    @property
    def commanded(self) -> bool:
        """Whether frequency and heading were recorded."""
        return {"frequency", "heading"} <= set(self.pieces[0].commands)

    @property
    def span(self) -> tuple[float, float]:
        """First and last time [s]."""
        first = min(piece.times[0] for piece in self.pieces)
        return float(first), float(max(piece.times[-1] for piece in self.pieces))

    @property
    def duration(self) -> float:
        """Observed time, gaps between segments left out [s]."""
        return float(sum(piece.times[-1] - piece.times[0] for piece in self.pieces))


def tracks(recording: Trajectories, *, pooled: bool = False) -> list[Track]:
    """The tracks of a recording, in the order in which they begin.

    Args:
        recording: positions `x`, `y` and, where it was driven, commands `frequency`
            and `heading`; its provenance names run and particle of each trajectory.
        pooled: all particles of a run as one track, as of bacteria that share physics.

    Raises:
        InputError: the channels are not x and y, or nothing is long enough to fit.
    """
    if recording.channels != ("x", "y"):
        raise InputError(
            f"recording: expected the channels x and y, got "
            f"{', '.join(recording.channels)}"
        )
    labels = recording.provenance.get("trajectories")
    labels = labels or [{"run": "run", "particle": i} for i in range(len(recording))]
    groups: dict[str, list[Trajectory]] = {}
    for label, piece in zip(labels, recording, strict=True):
        name = str(label["run"])
        name = name if pooled else f"{name}/{label['particle']}"
        seen = _observed(piece)
        if len(seen.times) >= LEAST_SAMPLES:
            groups.setdefault(name, []).append(seen)
    found = [_track(name, pieces) for name, pieces in groups.items()]
    if not found:
        raise InputError(
            f"recording: expected a trajectory of {LEAST_SAMPLES} samples or more, got "
            f"{int(recording.lengths.max())} at most; check how tracks are linked"
        )
    return found


LEAST_SAMPLES = 8
"""Segments with fewer samples say nothing of what is fitted here."""


def _track(name: str, pieces: Sequence[Trajectory]) -> Track:
    duration = float(sum(piece.times[-1] - piece.times[0] for piece in pieces))
    return Track(name, tuple(pieces), min(BLOCK, duration / BLOCKS_AT_LEAST))


def _observed(piece: Trajectory) -> Trajectory:
    """The samples at which both coordinates were seen."""
    return _cut(piece, piece.observed.all(axis=1))


def _cut(piece: Trajectory, kept: np.ndarray) -> Trajectory:
    return Trajectory(
        times=piece.times[kept],
        states=piece.states[kept],
        observed=piece.observed[kept],
        commands={name: values[kept] for name, values in piece.commands.items()},
    )


def before(track: Track, time: float) -> Track:
    """The part of a track before a time; blocks keep their length."""
    cut = [_cut(piece, piece.times < time) for piece in track.pieces]
    return _shortened(track, cut)


def after(track: Track, time: float) -> Track:
    """The part of a track from a time on; blocks keep their length."""
    cut = [_cut(piece, piece.times >= time) for piece in track.pieces]
    return _shortened(track, cut)


def _shortened(track: Track, pieces: Sequence[Trajectory]) -> Track:
    long = tuple(piece for piece in pieces if len(piece.times) >= LEAST_SAMPLES)
    if not long:
        raise InputError(
            f"track {track.name}: expected {LEAST_SAMPLES} samples or more on both "
            "sides of the split, got fewer; move it, or leave the track out"
        )
    return Track(track.name, long, track.width)


class Blocks(eqx.Module):
    """A track as padded arrays, for one compiled likelihood.

    Attributes:
        times: of each sample [s]; padding goes on increasing.
        positions: of each sample [L].
        frequency: commanded [Hz]; 0 where nothing was recorded.
        heading: commanded [rad].
        real: which samples are no padding.
        block: to which block each sample belongs.
        counts: samples in each block; 0 in padding.
    """

    times: Float[np.ndarray, "segment sample"]
    positions: Float[np.ndarray, "segment sample 2"]
    frequency: Float[np.ndarray, "segment sample"]
    heading: Float[np.ndarray, "segment sample"]
    real: Bool[np.ndarray, "segment sample"]
    block: Int[np.ndarray, "segment sample"]
    counts: Float[np.ndarray, "segment block"]

    @classmethod
    def of(cls, track: Track) -> "Blocks":
        """The blocks of a track; sizes are rounded up, to compile seldom."""
        own = [_block_indices(piece.times, track.width) for piece in track.pieces]
        samples = _rounded(max(len(piece.times) for piece in track.pieces), 512)
        blocks = _rounded(max(int(index[-1]) + 1 for index in own), 64)
        shape = _rounded(len(track.pieces), 1), samples
        arrays = {
            "times": np.tile(np.arange(samples, dtype=float), (shape[0], 1)),
            "positions": np.zeros((*shape, 2)),
            "frequency": np.zeros(shape),
            "heading": np.zeros(shape),
            "real": np.zeros(shape, bool),
            "block": np.zeros(shape, np.int64),
        }
        counts = np.zeros((shape[0], blocks))
        for row, (piece, index) in enumerate(zip(track.pieces, own, strict=True)):
            length = len(piece.times)
            arrays["times"][row] = piece.times[-1] + 1.0 + arrays["times"][row]
            arrays["times"][row, :length] = piece.times
            arrays["positions"][row, :length] = piece.states
            for name in ("frequency", "heading"):
                if name in piece.commands:
                    arrays[name][row, :length] = piece.commands[name]
            arrays["real"][row, :length] = True
            arrays["block"][row, :length] = index
            counts[row, : index[-1] + 1] = np.bincount(index)
        return cls(**arrays, counts=counts)


def _block_indices(times: np.ndarray, width: float) -> np.ndarray:
    """Number of the block of each sample; empty blocks are left out."""
    raw = np.floor((times - times[0]) / width + 1e-9).astype(np.int64)
    return np.unique(raw, return_inverse=True)[1]


def _rounded(count: int, least: int) -> int:
    """The next size: every one is four times the one before it."""
    size = least
    while size < count:
        size *= 4
    return size
