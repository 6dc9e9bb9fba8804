"""The results of `pinav reproduce`, as `metrics.json` holds them.

A number that is not finite, such as the error of a rollout that diverged, is null.
"""

import math

import msgspec


class Errors(msgspec.Struct, frozen=True):
    """Root-mean-square errors of rollouts, dimensionless.

    Attributes:
        x, y, vx, vy: of the components.
        total: root mean square of these four.
        position: of the position alone.
    """

    x: float | None
    y: float | None
    vx: float | None
    vy: float | None
    total: float | None
    position: float | None

    @property
    def values(self) -> tuple[float | None, ...]:
        """All of them, in the order of the table."""
        return msgspec.structs.astuple(self)


class Row(msgspec.Struct, frozen=True):
    """One line of Table 2.

    Attributes:
        model: name of the model.
        seed: seed of its network, or None where there is no network.
        x, y, vx, vy, total, position: its `Errors`.
    """

    model: str
    seed: int | None
    x: float | None
    y: float | None
    vx: float | None
    vy: float | None
    total: float | None
    position: float | None

    @property
    def errors(self) -> tuple[float, ...]:
        """Errors in the order of the table, infinite where the rollout diverged."""
        values = (self.x, self.y, self.vx, self.vy, self.total, self.position)
        return tuple(math.inf if value is None else value for value in values)


class Spread(msgspec.Struct, frozen=True):
    """Total errors of a model over its seeds."""

    median: float | None
    best: float | None
    worst: float | None


class PrintedLoss(msgspec.Struct, frozen=True):
    """The training loss as the paper states it."""

    start: float
    end: float


class TrainingLoss(msgspec.Struct, frozen=True):
    """The loss of one training.

    Attributes:
        start: before training.
        end: after training.
        decades: by how many powers of ten it fell.
        iterations: of the optimiser.
        outcome: the word for how training ended.
    """

    start: float | None
    end: float | None
    decades: float | None
    iterations: int
    outcome: str


class ForceErrors(msgspec.Struct, frozen=True):
    """Relative L2 error of the learned force by its distance to the data."""

    visited: float | None
    near: float | None
    everywhere: float | None

    @property
    def percent(self) -> tuple[float | None, ...]:
        """The errors in percent."""
        values = msgspec.structs.astuple(self)
        return tuple(None if value is None else 100 * value for value in values)


class ReproduceMetrics(msgspec.Struct, frozen=True):
    """The numbers of a reproduction of the paper.

    Attributes:
        recipe: how the models were trained.
        seeds: of the networks.
        table2: the lines of Table 2.
        paper_table2: the errors that the paper prints, by model.
        summary_total: total error of each model over its seeds.
        improvement: ratios of median total errors, by the names of the two models.
        loss: of each training, by model and seed.
        paper_loss: what the paper states.
        own_integrator_total: total error as the integrator of the training sees it.
        force_error: of each model with a force of its own.
        remarks: sentences on trainings that failed, each with a remedy.
    """

    recipe: str
    seeds: tuple[int, ...]
    table2: tuple[Row, ...]
    paper_table2: dict[str, Errors]
    summary_total: dict[str, Spread]
    improvement: dict[str, float | None]
    loss: dict[str, dict[str, TrainingLoss]]
    paper_loss: PrintedLoss
    own_integrator_total: dict[str, float | None]
    force_error: dict[str, ForceErrors]
    remarks: tuple[str, ...] = ()
