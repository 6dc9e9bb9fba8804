"""Numbers of results as JSON and tables hold them."""

import math

import msgspec

from pinav.evaluation import RolloutSummary

Cell = float | int | str | None
"""A score: None where it is not defined, "diverged" where it is infinite."""


def as_cell(value: float | int) -> Cell:
    """A number for JSON and tables: NaN is None, infinity the word "diverged"."""
    if isinstance(value, int):
        return value
    if math.isnan(value):
        return None
    return "diverged" if math.isinf(value) else float(value)


class RolloutRow(msgspec.Struct, frozen=True):
    """Position errors of rollouts within an interval of time, over trajectories.

    Attributes:
        median: of the root-mean-square error of each trajectory [L].
        high: its 90th percentile [L].
        median_relative: median of that error over the way travelled.
        high_relative: its 90th percentile.
        diverged: fraction of trajectories that diverged.
        trajectories: how many were scored.
    """

    median: Cell
    high: Cell
    median_relative: Cell
    high_relative: Cell
    diverged: Cell
    trajectories: int

    @classmethod
    def of(cls, summary: RolloutSummary) -> "RolloutRow":
        """The row of a summary of rollouts."""
        return cls(
            median=as_cell(summary.median),
            high=as_cell(summary.high),
            median_relative=as_cell(summary.median_relative),
            high_relative=as_cell(summary.high_relative),
            diverged=as_cell(summary.diverged),
            trajectories=summary.trajectories,
        )
