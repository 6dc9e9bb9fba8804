"""What a reproduction has to say: Table 2, Figure 1, the learned force."""

import dataclasses
import math
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from pinav.commands.reproduce import ReproduceSettings
from pinav.evaluation import Decomposition, FieldMap, force_errors
from pinav.figures import Picture, acceleration_figure, figure1, force_comparison
from pinav.fitting import Outcome
from pinav.learning.matching import Losses
from pinav.report import AbstractBlock, Cell, Paragraph, Section, Table

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
        seed: seed of its network; none where there is no network.
        errors: root-mean-square error of each component, of all (`total`) and of the
            position, dimensionless; infinite where the rollout diverged.
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
class Reproduction:
    """The paper's experiment.

    Attributes:
        times: times of the samples [T].
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
    def totals(self) -> dict[str, list[float]]:
        """Total error of each model for each of its seeds."""
        totals: dict[str, list[float]] = {}
        for row in self.table2:
            totals.setdefault(row.model, []).append(row.total)
        return totals

    @property
    def improvement(self) -> dict[str, float]:
        """Ratios of median total errors to that of the trained UDE."""
        median = {name: float(np.median(some)) for name, some in self.totals.items()}
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


HEADER = ("model", "seed", "x", "y", "vx", "vy", "total", "position")

PAPER = {
    "physics-only": (4.34, 2.46, 0.49, 0.39, 2.52, 3.53),
    "nn-only": (0.27, 0.27, 0.32, 0.28, 0.285, None),
    "ude-untrained": (3.71, 25.61, 0.59, 0.97, 12.95, None),
    "ude": (0.012, 0.013, 0.017, 0.017, 0.015, 0.0126),
}
"""The paper's printed errors: x, y, vx, vy, total; position-only from its text."""

PAPER_LOSS = (3.9e4, 4.5e-1)
"""The paper's training loss at start and end (section 3.1)."""

PAPER_STEPS = 8000
"""Steps of Adam and L-BFGS in the paper's Table 1."""

DIFFERENCES = (
    "The constants of the benchmark are identified from the paper's physics-only row, "
    "not published; they are one point of a family.",
    "NN-only: the paper prints 0.285. With the same training as the UDE, a black box "
    "that sees time fits this one trajectory far better than that, by the paper's own "
    "recipe as well as the UDE does. What tells them apart (other starts, longer "
    "horizons, the force field itself) is not in this table.",
    "UDE (untrained): depends on the random start of the network alone. The paper's "
    "own row (total 12.95) and the start of its loss curve (3.9e4, that is total 4.4) "
    "are not the same network, so no run can match both.",
    "All errors are of rollouts solved anew in float64 at tolerance 1e-11.",
)
"""Where our table and the paper's differ, and why."""


def csv_row(row: ModelRollout) -> tuple[Cell, ...]:
    """A line as it stands in `table2.csv`."""
    return (row.model, row.seed, *(repr(row.errors[name]) for name in HEADER[2:]))


def table2_blocks(result: Reproduction) -> list[Paragraph | Table]:
    """The table beside the paper's values, its spread over seeds, and the losses."""
    return [
        _table2(result),
        *map(Paragraph, result.remarks),
        *map(Paragraph, DIFFERENCES),
        _spread(result),
        Table(
            ("ratio of median total errors", "factor"),
            list(result.improvement.items()),
            "How many times smaller the trained UDE's error is.",
        ),
        _losses(result),
    ]


def _table2(result: Reproduction) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for model in ROWS:
        rows += [
            (row.model, row.seed, *(row.errors[name] for name in HEADER[2:]))
            for row in result.table2
            if row.model == model
        ]
        if model in PAPER:
            cells = ("–" if value is None else f"{value:g}" for value in PAPER[model])
            rows.append((f"{model}, as printed in the paper", "–", *cells))
    return Table(
        HEADER,
        rows,
        "Root-mean-square errors of rollouts from the true start, dimensionless. Total "
        "is the root mean square of the four columns.",
    )


def _spread(result: Reproduction) -> Table:
    rows = [
        (model, float(np.median(totals)), min(totals), max(totals))
        for model, totals in result.totals.items()
        if model not in ("physics-only", "ude-kernel")
    ]
    seeds = ", ".join(map(str, result.settings.seeds))
    caption = f"Total error over the seeds {seeds}."
    return Table(("model", "median", "best", "worst"), rows, caption)


def _losses(result: Reproduction) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for row in result.table2:
        if row.model in result.losses:
            losses = result.losses[row.model].values[result.place(row)]
            start, end = float(losses[0]), float(losses[-1])
            decades = float(np.log10(losses[0] / losses[-1]))
            steps = int(losses.size - 1)
            rows.append((row.model, row.seed, start, end, decades, steps))
    decades = math.log10(PAPER_LOSS[0] / PAPER_LOSS[1])
    rows.append(("ude, as printed", "42", *PAPER_LOSS, decades, PAPER_STEPS))
    header = ("model", "seed", "loss at start", "at end", "decades", "iterations")
    return Table(header, rows, "Training loss, the sum of squares of eq. (3).")


BARRIER = ([5.0, 5.0], 2.9)
"""Centre and width of the benchmark's barrier, drawn as context."""

KERNEL = "ude-kernel"
"""The row of the model with kernels in place of the network."""


def sections(result: Reproduction) -> list[Section]:
    """The table, the figure of each model, and what the models learned."""
    seed = result.settings.seeds[0]
    kernel = []
    if KERNEL in result.losses:
        text = (
            "The same physics with a static kernel potential in place of the network: "
            "linear in its weights, and nothing random in it."
        )
        blocks = [Paragraph(text), _figure1(result, None, KERNEL)]
        kernel = [Section("Figure 1 for the kernel residual", blocks)]
    left_out = Paragraph("The paper left this figure out.")
    alone = [left_out, _figure1(result, seed, "nn-only")]
    return [
        Section("Table 2", table2_blocks(result)),
        Section("Figure 1: the UDE", [_figure1(result, seed, "ude")]),
        Section("Figure 1 for the network alone", alone),
        *kernel,
        Section("The learned force", _forces(result, seed)),
        Section("What makes up the acceleration", [_parts(result, seed)]),
    ]


def _figure1(result: Reproduction, seed: int | None, model: str) -> Picture:
    label, losses = label_of(model, seed), result.losses[model]
    return Picture(
        f"figure1-{model}",
        lambda: figure1(
            result.times,
            result.truth,
            result.rollout(label_of(f"{model}-untrained", seed)).states,
            result.rollout(label).states,
            losses.values,
            losses.phases,
            model=model,
            barrier=BARRIER,
        ),
        f"{label}: (a, b) trajectory, (c) training loss with the change of phase "
        "marked, (d, e) velocity; before and after training, against the truth. "
        "Dimensionless, synthetic data.",
        alt=f"Trajectory, velocity and training loss of the model {model}",
    )


def _forces(result: Reproduction, seed: int) -> list[AbstractBlock]:
    drawn = [name for name in (f"ude-{seed}", KERNEL) if name in result.forces]
    rows = [
        (label, *(100 * error for error in errors.values()))
        for label, errors in result.force_error.items()
    ]
    return [
        *(_force(result, label) for label in drawn),
        Table(
            ("model", "visited (%)", "near (%)", "everywhere (%)"),
            rows,
            "Relative L2 error of the force on grid points within 0.35 of a sample, "
            "within 1.0, and on the whole grid.",
        ),
        Paragraph(
            "One trajectory does not determine the field: away from the path the "
            "learned force is an extrapolation, whatever the trajectory error says. "
            "The network also sees time; each point shows the time of the nearest "
            "sample, the reading most favourable to it."
        ),
    ]


def _force(result: Reproduction, label: str) -> Picture:
    return Picture(
        f"force-{label}",
        lambda: force_comparison(
            result.learned_field(label),
            true=result.true_field,
            path=result.truth[:, :2],
        ),
        f"The true force, that of {label}, and the difference.",
        alt="True force, learned force and their difference on a grid",
    )


def _parts(result: Reproduction, seed: int) -> Picture:
    learned = result.parts[f"ude-{seed}"]
    truth = Decomposition(
        result.times, learned.terms | {"environment": result.true_force}
    )
    return Picture(
        "acceleration",
        lambda: acceleration_figure(learned, true=truth),
        "a(t) = propulsion + environment + drag along the true trajectory, UDE of "
        f"seed {seed}.",
        alt="Propulsion, learned environment and drag along the trajectory",
    )
