"""Tracks: one robot of one run, its segments padded and cut into blocks.

A rolling robot jitters at its rolling frequency, by micrometres, and cameras alias
that. What is predicted here are seconds, not frames: likelihoods see the mean position
of each block of time, in which the jitter averages out.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from pinav.errors import InputError
from pinav.recordings import labels
from pinav.trajectories import Trajectories, Trajectory

BLOCK = 0.5
"""Length of a block at most [s]: long against frames, short against what is predicted.

At 0.3 s jitter leaks into the likelihood, at 1 s delays are lost (docs)."""

BLOCKS_AT_LEAST = 60
"""Shorter recordings are cut into shorter blocks, so that there are about as many."""


class Track(eqx.Module):
    """One robot of one run; never integrated across its segments.

    Attributes:
        sizes: samples and blocks to pad to; parts of a track keep them, so that a
            likelihood is compiled once.
    """

    name: str = eqx.field(static=True)
    pieces: tuple[Trajectory, ...]
    width: float = eqx.field(static=True)
    sizes: tuple[int, int] = eqx.field(static=True)

    @property
    def commanded(self) -> bool:
        """True where frequency and heading were recorded and ever asked for motion."""
        if not {"frequency", "heading"} <= set(self.pieces[0].commands):
            return False
        return any(np.any(piece.commands["frequency"] != 0) for piece in self.pieces)

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
        pooled: pool the particles of one kind in a run, such as bacteria, into one
            track.

    Raises:
        InputError: the channels are not x and y, or nothing is long enough to fit.
    """
    _check_planar(recording)
    groups: dict[str, list[Trajectory]] = {}
    names = _names(recording, pooled=pooled)
    for name, piece in zip(names, recording, strict=True):
        rest = _drop_unseen(piece)
        if len(rest.times) >= LEAST_SAMPLES:
            groups.setdefault(name, []).append(rest)
    if not groups:
        raise InputError(_too_short(recording))
    widths = [_block_width(pieces) for pieces in groups.values()]
    counts = [_counts(p, w) for p, w in zip(groups.values(), widths, strict=True)]
    rows = zip(groups.items(), widths, shared_sizes(counts), strict=True)
    return [
        Track(name, tuple(sorted(pieces, key=lambda p: p.times[0])), width, sizes)
        for (name, pieces), width, sizes in rows
    ]


def trajectories_of(
    recording: Trajectories, name: str, *, pooled: bool = False
) -> Trajectories:
    """The trajectories of one track; all where no track has this name."""
    names = _names(recording, pooled=pooled)
    chosen = [index for index, other in enumerate(names) if other == name]
    return recording.select(chosen) if chosen else recording


def _names(recording: Trajectories, *, pooled: bool) -> list[str]:
    """Name of the track of each trajectory: its run, and its particle or kind."""
    names = []
    for label in _labels(recording):
        parts = [label["run"], label.get("kind") if pooled else label["particle"]]
        names.append("/".join(str(part) for part in parts if part is not None))
    return names


def one_track(data: Trajectories, name: str) -> Track:
    """All trajectories as the segments of one track, one after the other in time."""
    _check_planar(data)
    seen = sorted(map(_drop_unseen, data), key=lambda piece: float(piece.times[0]))
    long = [piece for piece in seen if len(piece.times) >= LEAST_SAMPLES]
    pieces = [
        eqx.tree_at(lambda p: p.times, piece, times)
        for piece, times in zip(long, _times_in_turn(long), strict=True)
    ]
    if not pieces:
        raise InputError(_too_short(data))
    width = _block_width(pieces)
    return Track(name, tuple(pieces), width, _enclosing([_counts(pieces, width)]))


GAP = 10.0
"""Time between trajectories that are put one after the other [s]."""


def _times_in_turn(pieces: Sequence[Trajectory]) -> list[Float[np.ndarray, " time"]]:
    """Times of the pieces, shifted so that overlapping pieces follow each other."""
    made: list[Float[np.ndarray, " time"]] = []
    end = -np.inf
    for piece in pieces:
        begin = float(piece.times[0])
        later = end + GAP - begin if begin <= end else 0.0
        made.append(piece.times + later)
        end = float(made[-1][-1])
    return made


def _check_planar(recording: Trajectories) -> None:
    if recording.channels != ("x", "y"):
        raise InputError(
            f"recording: expected the channels x and y, got "
            f"{', '.join(recording.channels)}"
        )


def _too_short(recording: Trajectories) -> str:
    return (
        f"recording: expected a trajectory of {LEAST_SAMPLES} samples or more, got "
        f"{int(recording.lengths.max())} at most; check how tracks are linked"
    )


def _labels(recording: Trajectories) -> list[dict[str, str | int]]:
    """Run and particle of each trajectory; numbers where nothing is known of them."""
    if "trajectories" in recording.provenance or "concatenated" in recording.provenance:
        return labels(recording)
    return [{"run": "run", "particle": index} for index in range(len(recording))]


LEAST_SAMPLES = 8
"""Segments with fewer samples say nothing of what is fitted here."""


def _block_width(pieces: Sequence[Trajectory]) -> float:
    duration = float(sum(piece.times[-1] - piece.times[0] for piece in pieces))
    return min(BLOCK, duration / BLOCKS_AT_LEAST)


def _counts(pieces: Sequence[Trajectory], width: float) -> tuple[int, int]:
    blocks = sum(int(block_indices(piece.times, width)[-1]) + 1 for piece in pieces)
    return sum(len(piece.times) for piece in pieces), blocks


COMPILATION, PER_SAMPLE, PER_BLOCK = 6.0, 1.5e-4, 3.6e-3
"""Rough seconds: to compile a likelihood for a size, and to fit all candidates for each
sample and block of it. Only how tracks share sizes hangs on them, no result."""


def shared_sizes(counts: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Samples and blocks to pad each track to: as few sizes as pay for themselves.

    A size is compiled once, in seconds, and then serves all tracks that are padded to
    it; but padding is computed with. Tracks ordered by length are cut into groups of
    least total time, by dynamic programming.
    """
    order = sorted(range(len(counts)), key=lambda i: counts[i][::-1])
    best: list[float] = [0.0]
    cuts: list[int] = []
    for end in range(1, len(order) + 1):
        totals = []
        for begin in range(end):
            samples, blocks = _enclosing([counts[i] for i in order[begin:end]])
            each = PER_SAMPLE * samples + PER_BLOCK * blocks
            totals.append(best[begin] + COMPILATION + (end - begin) * each)
        cuts.append(int(np.argmin(totals)))
        best.append(min(totals))
    sizes, end = [(0, 0)] * len(counts), len(order)
    while end:
        begin = cuts[end - 1]
        group = order[begin:end]
        for index in group:
            sizes[index] = _enclosing([counts[i] for i in group])
        end = begin
    return sizes


def _enclosing(counts: Sequence[tuple[int, int]]) -> tuple[int, int]:
    """The size of the largest, in round numbers."""
    samples, blocks = (max(column) for column in zip(*counts, strict=True))
    return round_up_to(samples, 256), round_up_to(blocks, 32)


def round_up_to(count: int, step: int) -> int:
    """The next multiple of `step`, one at least."""
    return step * max(1, -(-count // step))


def _drop_unseen(piece: Trajectory) -> Trajectory:
    """The samples at which both coordinates were seen."""
    return _keep_rows(piece, piece.observed.all(axis=1))


def _keep_rows(piece: Trajectory, kept: Any) -> Trajectory:
    return jax.tree.map(lambda values: values[kept], piece)


def commands_of(piece: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Frequency and heading of a segment; zeros where nothing was commanded."""
    nothing = np.zeros_like(piece.times)
    return (
        piece.commands.get("frequency", nothing),
        piece.commands.get("heading", nothing),
    )


def cut_track(track: Track, kept: Callable[[np.ndarray], np.ndarray]) -> Track:
    """The part of a track at the times that are kept; blocks keep their length.

    Raises:
        InputError: it is too short.
    """
    cut = [_keep_rows(piece, kept(piece.times)) for piece in track.pieces]
    long = tuple(piece for piece in cut if len(piece.times) >= LEAST_SAMPLES)
    if not long:
        raise InputError(
            f"track {track.name}: expected {LEAST_SAMPLES} samples or more on both "
            "sides of the split, got fewer; move it, or leave the track out"
        )
    return Track(track.name, long, track.width, track.sizes)


class Blocks(NamedTuple):
    """A track as padded arrays, one segment after the other.

    A tuple, which passes into a compiled program more quickly than a module does.

    Attributes:
        times: time of each sample [s], increasing in padding too; overlapping segments
            are put one after the other.
        begins: 1 where a segment begins with the block.
    """

    times: Float[np.ndarray, " sample"]
    positions: Float[np.ndarray, "sample 2"]
    frequency: Float[np.ndarray, " sample"]
    heading: Float[np.ndarray, " sample"]
    real: Bool[np.ndarray, " sample"]
    block: Int[np.ndarray, " sample"]
    counts: Float[np.ndarray, " block"]
    begins: Float[np.ndarray, " block"]

    @classmethod
    def of(cls, track: Track) -> "Blocks":
        """The blocks of a track."""
        indices = [block_indices(piece.times, track.width) for piece in track.pieces]
        samples, blocks = track.sizes
        first = np.cumsum([0, *(int(index[-1]) + 1 for index in indices)])
        index = np.concatenate(
            [i + f for i, f in zip(indices, first[:-1], strict=True)]
        )
        length = len(index)
        begins, counts = np.zeros((2, blocks))
        begins[first[:-1]] = 1.0
        counts[: first[-1]] = np.bincount(index)

        commands = zip(*map(commands_of, track.pieces), strict=True)
        padded = [np.pad(np.concatenate(c), (0, samples - length)) for c in commands]
        times = np.concatenate(_times_in_turn(track.pieces))
        # Time goes on in the padding, so that no interval vanishes.
        later = times.max() + 1.0 + np.arange(samples - length)
        states = np.concatenate([piece.states for piece in track.pieces])
        return cls(
            times=np.concatenate([times, later]),
            positions=np.pad(states, ((0, samples - length), (0, 0))),
            frequency=padded[0],
            heading=padded[1],
            real=np.arange(samples) < length,
            block=np.pad(index, (0, samples - length)),
            counts=counts,
            begins=begins,
        )

    def means(
        self, values: Float[np.ndarray, "sample column"]
    ) -> Float[np.ndarray, "block column"]:
        """Means over the samples of each block; zero in padding."""
        index, count = self.block[self.real], len(self.counts)
        totals = [np.bincount(index, one[self.real], count) for one in values.T]
        return np.stack(totals, axis=1) / np.maximum(self.counts, 1.0)[:, None]


def block_indices(times: np.ndarray, width: float) -> np.ndarray:
    """Number of the block of each sample; empty blocks are left out."""
    # A sample on the border of two blocks belongs to the later one, whatever its
    # rounding.
    raw = np.floor((times - times[0]) / width + 1e-9).astype(np.int64)
    return np.unique(raw, return_inverse=True)[1]
