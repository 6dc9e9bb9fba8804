"""`RunningFit`: what is known of the drive of a robot after each frame."""

import dataclasses

import equinox as eqx
import numpy as np
from jaxtyping import Float

from pinav.identification.running.bank import (
    REACH,
    Bank,
    CommandHistory,
    DriveGrid,
    Frames,
)

BLOCK = 0.5
"""Positions are averaged over so many seconds, as in identification."""

SCALE_TIME = 2.0
"""Seconds of drive from which the speed of a robot is told roughly."""

BEFORE_DRIVE = 3
"""Frames before the first drive that are kept."""

LEAST_SEEN = 4
"""Frames with a position from which the speed is told."""

JITTER_MEMORY = 800.0
"""Coordinates over which the scatter of single frames is averaged."""


class RunningFit(eqx.Module):
    """Gain, heading offset, response, delay, drift and wandering, as a value.

    Nothing is learned before the robot is first driven. Memory is bounded: states of
    the bank, some seconds of commands, and the frames of a block.

    Attributes:
        bank: filter states; none until the robot was driven for `SCALE_TIME`.
        history: the last seconds of commands; none before the first frame.
        frames: frames of the open block.
        since: time of the first drive [s]; none before.
        scale: rough speed per frequency [L per cycle].
        cycles: mean of the integrated commands in the last closed block, of each drive;
            none where positions begin anew.
        jitter: variance of a coordinate of single frames about the path [L²].
    """

    grid: DriveGrid
    bank: Bank | None = None
    history: CommandHistory | None = None
    frames: Frames = dataclasses.field(default_factory=Frames.none)
    since: float | None = None
    scale: float = 0.0
    block_begin: float = 0.0
    block_time: float = 0.0
    cycles: Float[np.ndarray, "drive 2"] | None = None
    block_frequency: float = 0.0
    jitter: float = 0.0
    jitter_count: float = 0.0
    fastest: float = 0.0

    @classmethod
    def begin(cls, grid: DriveGrid | None = None) -> "RunningFit":
        """An empty fit, with the default grid unless another one is given."""
        return cls(DriveGrid.default() if grid is None else grid)

    def after(
        self,
        time: float,
        position: tuple[float, float] | None,
        frequency: float,
        heading: float,
    ) -> "RunningFit":
        """The fit after a frame [s, L] and the command from then on [Hz, rad]."""
        frame = Frames.one(time, position, frequency, heading)
        fit = dataclasses.replace(
            self, history=self._extend(frame), fastest=max(self.fastest, frequency)
        )
        if fit.since is None:
            if frequency <= 0:
                kept = fit.frames[slice(1 - BEFORE_DRIVE, None)]
                return dataclasses.replace(fit, frames=kept + frame)
            fit = dataclasses.replace(fit, since=time)
        if fit.bank is None:
            return dataclasses.replace(fit, frames=fit.frames + frame)._start()
        return fit._take(frame)

    def restart(
        self,
        time: float,
        position: tuple[float, float] | None,
        frequency: float,
        heading: float,
    ) -> "RunningFit":
        """The fit after a frame that does not continue those before it.

        What was learned of the drive is kept; position, wandering and past commands are
        not.
        """
        frame = Frames.one(time, position, frequency, heading)
        return dataclasses.replace(
            self,
            history=CommandHistory.begin(self.grid, frame),
            frames=frame,
            block_begin=time,
            cycles=None,
            since=self.since if self.bank is not None else None,
        )

    def _extend(self, frame: Frames) -> CommandHistory:
        """The commands with those of a frame, less what is too old to act."""
        if self.history is None:
            return CommandHistory.begin(self.grid, frame)
        later = self.history.extend(self.grid, frame)
        if self.bank is None:
            return later
        return later.forget(frame.times[0] - REACH - self.grid.delays[-1])

    def _start(self) -> "RunningFit":
        """The bank, once the speed is known roughly, and what it says of all frames."""
        observed = self.frames.observed
        assert self.since is not None
        if (
            self.frames.times[-1] < self.since + SCALE_TIME
            or len(observed) < LEAST_SEEN
        ):
            return self
        scale = _speed_per_frequency(observed, self.frames)
        fit = dataclasses.replace(
            self,
            bank=Bank.prior(self.grid.log_prior, scale),
            scale=scale,
            frames=Frames.none(),
            block_begin=float(self.frames.times[0]),
        )
        for place in range(len(self.frames)):
            fit = fit._take(self.frames[slice(place, place + 1)])
        return fit

    def _take(self, frame: Frames) -> "RunningFit":
        """With a frame in the open block, after the one before has been closed."""
        time = float(frame.times[0])
        fit = self
        if time >= self.block_begin + BLOCK - 1e-9:
            fit = self._close()
            blocks = np.floor((time - self.block_begin) / BLOCK + 1e-9)
            begin = self.block_begin + float(blocks) * BLOCK
            fit = dataclasses.replace(fit, frames=Frames.none(), block_begin=begin)
        return dataclasses.replace(fit, frames=fit.frames + frame)

    def _close(self) -> "RunningFit":
        """The bank that knows the mean position of the open block."""
        observed = self.frames.observed
        if not len(observed):
            return self
        assert self.bank is not None
        assert self.history is not None
        time = float(observed.times.mean())
        position = observed.positions.mean(axis=0)
        frequency = float(observed.frequency.mean())
        delayed = observed.times[:, None] - self.grid.delays
        cycles = self.history.at(delayed).mean(axis=0)
        if self.cycles is None:
            bank = self.bank.place(position, self.grid.blur)
        else:
            change = (cycles - self.cycles)[self.grid.drive]
            between = (frequency + self.block_frequency) / 2
            interval = time - self.block_time
            ahead = self.bank.predict(change, interval, self.grid.memory, between)
            bank = ahead.update(position, self.grid.blur)
        jitter, count = self._scatter(observed)
        return dataclasses.replace(
            self,
            bank=bank,
            block_time=time,
            block_frequency=frequency,
            cycles=cycles,
            jitter=jitter,
            jitter_count=count,
        )

    def _scatter(self, observed: Frames) -> tuple[float, float]:
        """Scatter of single frames about a line through a block, and its count."""
        if len(observed) < 3:
            return self.jitter, self.jitter_count
        times = observed.times - observed.times.mean()
        basis = np.stack([np.ones_like(times), times], axis=1)
        line = basis @ np.linalg.lstsq(basis, observed.positions)[0]
        more = 2.0 * (len(observed) - 2)
        before = min(self.jitter_count, JITTER_MEMORY)
        total = self.jitter * before + float(((observed.positions - line) ** 2).sum())
        return total / (before + more), before + more


def _speed_per_frequency(observed: Frames, frames: Frames) -> float:
    """Way of the robot, in steps of a block, over the cycles that were commanded."""
    duration = float(observed.times[-1] - observed.times[0])
    step = max(1, round(BLOCK * (len(observed) - 1) / duration))
    way = np.hypot(*np.diff(observed.positions[::step], axis=0).T).sum()
    return max(float(way) / (float(frames.frequency.mean()) * duration), 1e-9)
