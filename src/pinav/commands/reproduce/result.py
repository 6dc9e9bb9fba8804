"""The result of `pinav reproduce`: what was trained, and how far its rollouts err."""

import dataclasses
import math
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from pinav.commands.reproduce import ReproduceSettings
from pinav.evaluation import Decomposition, FieldMap, force_errors
from pinav.fitting import Outcome
from pinav.learning.matching import Losses

FAILED = tuple(map(str, (Outcome.STALLED, Outcome.MISFIT, Outcome.DIVERGED)))
"""Words for trainings that ended before the data were explained."""

FAILED_ERROR = 1e-2
"""Total error beyond which such a training failed; the paper's own is 1.5e-2."""

ROWS = ("physics-only", "nn-only", "ude-untrained", "ude", "ude-kernel")
"""Models in the order of Table 2: the paper's, then what it does not have."""


@dataclasses.dataclass(frozen=True)
class ModelRollout:
    """A rollout of a model from the true start.

    Attributes:
        model: name of the model.
        seed: seed of its network; none where there is no network.
        errors: root-mean-square error of each component, of all (`total`) and of the
            position, dimensionless; infinite where the rollout diverged.
        states: the rollout.
    """

    model: str
    seed: int | None
    errors: dict[str, float]
    states: Float[np.ndarray, "time 4"]

    @property
    def label(self) -> str:
        """Name and seed, as files are called."""
        return label_of(self.model, self.seed)

    @property
    def total(self) -> float:
        """Root mean square of the errors of the four components."""
        return self.errors["total"]


def label_of(model: str, seed: int | None) -> str:
    """Name and seed of a model, as files are called."""
    return model if seed is None else f"{model}-{seed}"


@dataclasses.dataclass(frozen=True)
class Spread:
    """Total errors of a model over its seeds.

    Attributes:
        median: median of them.
        best: smallest of them.
        worst: largest of them.
    """

    median: float
    best: float
    worst: float


@dataclasses.dataclass(frozen=True)
class Reproduction:
    """The paper's experiment.

    Attributes:
        settings: recipe and seeds.
        times: times of the samples [T].
        truth: true states.
        rollouts: of every model, before and after training.
        losses: of the trainings of each model, one for each seed.
        own_integrator_total: total error of each trained model as the integrator of
            the training sees it.
        true_field: the true force on a grid.
        forces: the learned force of each model that has one, on the same grid [L T⁻²].
        true_force: the true force along the trajectory [L T⁻²].
        parts: what makes up the acceleration of each of these models.
    """

    settings: ReproduceSettings
    times: Float[np.ndarray, " time"]
    truth: Float[np.ndarray, "time 4"]
    rollouts: tuple[ModelRollout, ...]
    losses: dict[str, Losses]
    own_integrator_total: dict[str, float]
    true_field: FieldMap
    forces: dict[str, Float[np.ndarray, "rows columns 2"]]
    true_force: Float[np.ndarray, "time 2"]
    parts: dict[str, Decomposition]

    DERIVED: ClassVar = ("improvement", "force_error", "remarks")

    @property
    def table2(self) -> list[ModelRollout]:
        """The lines of Table 2."""
        listed = [one for one in self.rollouts if one.model in ROWS]
        return sorted(listed, key=lambda one: ROWS.index(one.model))

    @property
    def summary_total(self) -> dict[str, Spread]:
        """Median, best and worst total error of each model over its seeds."""
        totals: dict[str, list[float]] = {}
        for row in self.table2:
            totals.setdefault(row.model, []).append(row.total)
        return {
            model: Spread(float(np.median(values)), min(values), max(values))
            for model, values in totals.items()
        }

    @property
    def improvement(self) -> dict[str, float]:
        """Ratios of median total errors to that of the trained UDE."""
        median = {model: one.median for model, one in self.summary_total.items()}
        factors = {
            f"{model} / ude": median[model] / median["ude"]
            for model in median
            if model not in ("ude", "ude-kernel")
        }
        if "ude-kernel" in median:
            factors["ude / ude-kernel"] = median["ude"] / median["ude-kernel"]
        return factors

    @property
    def force_error(self) -> dict[str, dict[str, float]]:
        """Relative L2 error of each learned force by the distance to the data."""
        return {
            label: force_errors(self.learned_field(label), self.true_field)
            for label in self.forces
        }

    @property
    def remarks(self) -> list[str]:
        """A sentence for each training that did not converge and misses the data."""
        return [
            f"{row.model}, seed {row.seed}: the fit failed ({outcome}), its rollouts "
            f"miss the data by {short(row.total)}; choose other --seeds."
            for row in self.table2
            if row.model in self.losses
            for outcome in [self.losses[row.model].outcomes[self.place(row)]]
            if outcome in FAILED and row.total > FAILED_ERROR
        ]

    def place(self, rollout: ModelRollout) -> int:
        """The place of a model's training among those of all seeds."""
        seed = rollout.seed
        return 0 if seed is None else self.settings.seeds.index(seed)

    def rollout(self, label: str) -> ModelRollout:
        """The rollout of a model, by its name and seed."""
        return next(one for one in self.rollouts if one.label == label)

    def learned_field(self, label: str) -> FieldMap:
        """The learned force of a model on the grid of the true one."""
        return self.true_field.showing(self.forces[label])


def short(error: float) -> str:
    """An error to three significant digits, or "diverged"."""
    return f"{error:.3g}" if math.isfinite(error) else "diverged"
