"""Where time steps end: at every switch of the protocol and every time asked for."""

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from pinav.errors import InputError
from pinav.thermal.protocols import AbstractProtocol
from pinav.thermal.quantities import Number, Numbers

COINCIDENT = 1e-9
"""Times closer than this, relative to the duration, are one time."""


class Schedule(eqx.Module):
    """All steps of a run, none of which crosses a switch or a saved time.

    Steps of no length fill up the last block, so that blocks are equal.

    Attributes:
        starts: begin of each step [s].
        steps: length of each step [s].
        intervals: of the protocol, in which each step lies.
        saved: indices of the steps whose ends are the saved times.
        times: the saved times [s].
        block: steps whose states are recomputed together in reverse mode.
    """

    starts: Float[np.ndarray, " step"]
    steps: Float[np.ndarray, " step"]
    intervals: Int[np.ndarray, " step"]
    saved: Int[np.ndarray, " time"]
    times: Float[np.ndarray, " time"]
    block: int = eqx.field(static=True)


def plan_steps(
    protocol: AbstractProtocol,
    longest: Number,
    *,
    save_every: Number | None = None,
    save_at: Numbers | None = None,
    start: Number = 0.0,
) -> Schedule:
    """Equal steps between each two events, as long as allowed.

    Args:
        protocol: whose edges are events.
        longest: longest step [s].
        save_every: interval [s] between saved times; the end is saved too.
        save_at: saved times [s], in place of `save_every`; the end alone unless given.
        start: time [s] at which the run begins, after a restart.

    Raises:
        InputError: a saved time or the start is outside the protocol.
    """
    end = protocol.duration
    if not 0 <= start < end:
        raise InputError(
            f"schedule start: expected within 0 and {end:g} s, got {start:g}"
        )
    times = _saved_times(start, end, save_every, save_at)
    inner = [t for t in protocol.edges if start < t < end]
    events = _merge(np.concatenate([[start, end], inner, times]), end)
    # less a little, so that rounding does not add a step
    counts = np.maximum(np.ceil(np.diff(events) / longest - 1e-9), 1).astype(int)
    steps = np.repeat(np.diff(events) / counts, counts)
    starts = np.concatenate(
        [
            a + (b - a) * np.arange(n) / n
            for a, b, n in zip(events[:-1], events[1:], counts, strict=True)
        ]
    )
    # by the middle of a step, because its ends may coincide with edges up to rounding
    middles = starts + 0.5 * steps
    intervals = np.searchsorted(protocol.edges, middles) - 1
    ends = np.append(0, np.cumsum(counts)) - 1
    nearest = np.abs(events[:, None] - times[None]).argmin(axis=0)
    # the square root balances kept and recomputed states in reverse mode
    block = max(1, int(np.ceil(np.sqrt(len(steps)))))
    padding = -len(steps) % block
    return Schedule(
        starts=np.append(starts, np.full(padding, end)),
        steps=np.append(steps, np.zeros(padding)),
        intervals=np.append(intervals, np.full(padding, intervals[-1])),
        saved=ends[nearest],
        times=times,
        block=block,
    )


def _saved_times(
    start: Number, end: Number, save_every: Number | None, save_at: Numbers | None
) -> np.ndarray:
    if save_at is not None:
        times = np.asarray(save_at, float).reshape(-1)
        outside = (times <= start) | (times > end * (1 + COINCIDENT))
        if outside.any():
            raise InputError(
                f"saved time {times[outside][0]:g} s: expected after {start:g} and up "
                f"to {end:g} s, the end of the protocol"
            )
        return np.unique(times)
    if save_every is None:
        return np.array([end])
    if not save_every > 0:
        raise InputError(f"save_every: expected a time > 0 s, got {save_every}")
    count = int(np.floor((end - start) / save_every * (1 + COINCIDENT)))
    times = start + save_every * np.arange(1, count + 1)
    return _merge(np.append(times, end), end)


def _merge(times: np.ndarray, end: Number) -> np.ndarray:
    """Sorted times, those that coincide only once."""
    ordered = np.sort(times)
    kept = np.append(True, np.diff(ordered) > COINCIDENT * end)
    return ordered[kept]
