"""The results of `pinav study`, as `metrics.json` holds them."""

from typing import ClassVar

import msgspec

from pinav.commands.cells import Cell


class StudyRow(msgspec.Struct, frozen=True):
    """One fit of a study; one that failed has no scores.

    Attributes:
        model: name of the model.
        seed: of starts, noise and network.
        trajectories: how many it was fitted to.
        sigma: standard deviation of the observations.
        outcome: the word for how the fit ended, or why it failed.
        force_visited, force_near, force_unvisited: relative L2 error of the force by
            the distance to the data.
        cosine_visited: cosine similarity of the force.
        rollouts_median, rollouts_high: median and 90th percentile of the
            root-mean-square position error over held-out starts [L].
        rollouts_diverged: fraction of them that diverged.
    """

    model: str
    seed: int
    trajectories: int
    sigma: float
    outcome: str = ""
    force_visited: Cell = msgspec.field(default=None, name="force visited")
    force_near: Cell = msgspec.field(default=None, name="force near")
    force_unvisited: Cell = msgspec.field(default=None, name="force unvisited")
    cosine_visited: Cell = msgspec.field(default=None, name="cosine visited")
    rollouts_median: Cell = msgspec.field(default=None, name="rollouts median")
    rollouts_high: Cell = msgspec.field(default=None, name="rollouts 90 %")
    rollouts_diverged: Cell = msgspec.field(default=None, name="rollouts diverged")


HEADER = tuple(field.encode_name for field in msgspec.structs.fields(StudyRow))
"""Columns of the table of a study."""


class ScalingMetrics(msgspec.Struct, frozen=True):
    """The numbers of a study over the size or the noise of the data.

    Attributes:
        scenario: that the data are of.
        rows: one for each fit.
    """

    scenario: str
    rows: tuple[StudyRow, ...]

    name: ClassVar[str]
    quantity: ClassVar[str]


class DataEfficiencyMetrics(
    ScalingMetrics, frozen=True, tag="data-efficiency", tag_field="study"
):
    """A study over the number of trajectories."""

    name: ClassVar[str] = "data-efficiency"
    quantity: ClassVar[str] = "number of trajectories"


class NoiseMetrics(ScalingMetrics, frozen=True, tag="noise", tag_field="study"):
    """A study over the noise of the observations."""

    name: ClassVar[str] = "noise"
    quantity: ClassVar[str] = "noise of the observations"


StudyMetrics = DataEfficiencyMetrics | NoiseMetrics
