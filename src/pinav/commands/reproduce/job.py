"""`pinav reproduce`: the paper's experiment, from nothing to its table and figures."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from pinav.commands.command import CommandResult
from pinav.commands.progress import Reporter
from pinav.commands.reproduce import REPRODUCE, table2
from pinav.commands.reproduce.metrics import (
    ForceErrors,
    ReproduceMetrics,
    Row,
    TrainingLoss,
)
from pinav.commands.reproduce.settings import ReproduceOptions, ReproduceSettings
from pinav.commands.reproduce.table2 import (
    HEADER,
    PAPER,
    PAPER_LOSS,
    ROWS,
    cells,
    improvements,
    scored_row,
    summary,
)
from pinav.commands.start import start_run
from pinav.dynamics import AbstractDynamics, FixedStep, Swimmer
from pinav.evaluation import (
    FieldMap,
    decompose,
    field_map,
    force_errors,
    predict,
    score,
)
from pinav.fitting.environments.catalogue import build
from pinav.fitting.environments.choice import ModelChoice, learned_part
from pinav.fitting.environments.summary import summarise_for_matching
from pinav.learning.learned import Learned, ModelHeader, write_model
from pinav.learning.matching import Losses, matching
from pinav.learning.recipes import Curriculum, Paper
from pinav.learning.system_choice import write_system_of
from pinav.runs import RunFolder
from pinav.scenarios import scenario
from pinav.systems import System
from pinav.trajectories import Trajectories, load, save, simulate


@dataclasses.dataclass(frozen=True)
class Entry:
    """One kind of model that is trained, for all its seeds.

    Attributes:
        name: name of its row.
        seeds: seeds of its network; (None,) where there is nothing random.
        model: name of the model in the catalogue.
    """

    name: str
    seeds: tuple[int | None, ...]
    model: str

    def choice(self, seed: int | None) -> ModelChoice:
        """The model with the network of that seed."""
        return ModelChoice(self.model, seed=seed or 0)

    def labels(self) -> list[str]:
        """Name and seed of each member, as files and arrays are called."""
        return [key_of(self.name, seed) for seed in self.seeds]


def entries(settings: ReproduceSettings) -> list[Entry]:
    """What the recipe trains."""
    return [
        Entry(name, (None,) if model.startswith("kernel-") else settings.seeds, model)
        for name, model in REPRODUCED[settings.recipe].items()
    ]


REPRODUCED = {
    "paper": {"ude": "paper-ude", "nn-only": "paper-nn-only"},
    "default": {"ude": "ude", "nn-only": "nn-only", "ude-kernel": "kernel-potential"},
}
"""Models of each recipe, by the name of their row in Table 2."""


def reproduce(settings: ReproduceSettings, folder: RunFolder) -> list[Row]:
    """Simulate the benchmark, train the models, score, and write the results.

    Whatever the folder already holds is not computed again.

    Args:
        settings: recipe and seeds.
        folder: the run.

    Returns:
        The rows of Table 2.
    """
    benchmark = scenario("paper")
    write_system_of(folder, benchmark)
    data = _data(benchmark, folder)
    chosen = entries(settings)
    for entry in chosen:
        if not all(folder.has(model_file(label)) for label in entry.labels()):
            _write_fits(entry, settings, data, folder)
    rows, arrays = _evaluate(benchmark, data, chosen, folder)
    folder.write_table("table2.csv", HEADER, [cells(row) for row in rows])
    folder.write_arrays("results.npz", arrays)
    folder.write_metrics("metrics.json", _metrics(settings, rows, arrays, folder))
    return rows


def _data(benchmark: System, folder: RunFolder) -> Trajectories:
    if not folder.has("data.npz"):
        save(simulate(benchmark), folder.path / "data.npz")
    return load(folder.path / "data.npz")


def model_file(label: str) -> str:
    """Name of the file that holds a trained model."""
    return f"model-{label}.eqx"


def _write_fits(
    entry: Entry, settings: ReproduceSettings, data: Trajectories, folder: RunFolder
) -> None:
    """Train, and write losses first: a model file says that all of its fit is there."""
    known = scenario("paper").swimmer
    summary = summarise_for_matching(entry.choice(None), known, data)
    models = [build(entry.choice(seed), known, summary) for seed in entry.seeds]
    recipe = (
        Paper(settings.adam_steps, settings.lbfgs_steps)
        if settings.recipe == "paper"
        else Curriculum(settings.max_steps)
    )
    method = matching(recipe, data, models[0])
    with Reporter(folder, entry.name) as report:
        fits = method.fit(
            models,
            data,
            trainable=learned_part,
            checkpoint=folder.checkpoint(entry.name),
            on_chunk=report,
        )
    folder.store(f"losses-{entry.name}", Losses.of(fits))
    for seed, label, fit in zip(entry.seeds, entry.labels(), fits, strict=True):
        header = ModelHeader(entry.choice(seed), summary, method.precision)
        write_model(folder, header, fit.model, model_file(label))


def _evaluate(
    benchmark: System,
    data: Trajectories,
    chosen: Sequence[Entry],
    folder: RunFolder,
) -> tuple[list[Row], dict[str, np.ndarray]]:
    """Score every model; return the rows and the arrays behind the figures."""
    arrays = {"times": data.times[0], "truth": data.states[0]}
    truth = benchmark.true_swimmer
    assert isinstance(truth, Swimmer)
    arrays |= _true_arrays(truth, data)
    fitted = Learned.open(folder.path)

    def scored(model: str, seed: int | None, dynamics: AbstractDynamics) -> Row:
        predictions, outcomes = predict(dynamics, data)
        arrays[key_of(model, seed)] = predictions[0]
        return scored_row(model, seed, score(predictions, outcomes, data))

    rows = [scored("physics-only", None, benchmark.swimmer)]
    for entry in chosen:
        summary = summarise_for_matching(entry.choice(None), benchmark.swimmer, data)
        for seed, label in zip(entry.seeds, entry.labels(), strict=True):
            before = build(entry.choice(seed), benchmark.swimmer, summary)
            trained = fitted.models[f"model-{label}"]
            rows.append(scored(f"{entry.name}-untrained", seed, before))
            rows.append(scored(entry.name, seed, trained))
            integrated, _ = predict(trained, data, solver=FixedStep())
            arrays[f"{label}/own"] = integrated[0]
            if isinstance(trained, Swimmer):
                arrays |= _force_arrays(trained, label, data)
    order = list(ROWS)
    listed = [row for row in rows if row.model in order]
    return sorted(listed, key=lambda row: order.index(row.model)), arrays


def _true_arrays(truth: Swimmer, data: Trajectories) -> dict[str, np.ndarray]:
    """The true force on the grid and along the trajectory."""
    true = field_map(truth.environment, data)
    parts = decompose(truth, data.times[0], data.states[0])
    return {
        "field/x": true.x,
        "field/y": true.y,
        "field/distance": true.distance,
        "field/true": true.force,
        "parts/true": parts.terms["environment"],
    }


def _force_arrays(
    swimmer: Swimmer, label: str, data: Trajectories
) -> dict[str, np.ndarray]:
    """The learned force on the grid, and the parts of the acceleration."""
    learned = field_map(swimmer.environment, data)
    parts = decompose(swimmer, data.times[0], data.states[0])
    arrays = {f"parts/{label}/{name}": terms for name, terms in parts.terms.items()}
    return arrays | {f"field/{label}": learned.force}


def key_of(model: str, seed: int | None) -> str:
    """Name and seed of a model, as files and arrays are called."""
    return model if seed is None else f"{model}-{seed}"


def _metrics(
    settings: ReproduceSettings,
    rows: list[Row],
    arrays: dict[str, np.ndarray],
    folder: RunFolder,
) -> ReproduceMetrics:
    """Everything that a script would ask for; nothing that varies with the clock."""
    chosen = entries(settings)
    labels = [label for entry in chosen for label in entry.labels()]
    with_force = [label for label in labels if f"field/{label}" in arrays]
    true = FieldMap.of_arrays(arrays, "true")
    losses = {entry.name: _losses(entry, folder) for entry in chosen}
    return ReproduceMetrics(
        recipe=settings.recipe,
        seeds=settings.seeds,
        table2=tuple(rows),
        paper_table2=PAPER,
        summary_total=summary(rows),
        improvement=dict(improvements(rows)),
        loss=losses,
        remarks=tuple(table2.failures(rows, losses)),
        paper_loss=PAPER_LOSS,
        own_integrator_total={label: _own_total(arrays, label) for label in labels},
        force_error={
            label: ForceErrors(**force_errors(FieldMap.of_arrays(arrays, label), true))
            for label in with_force
        },
    )


def _losses(entry: Entry, folder: RunFolder) -> dict[str, TrainingLoss]:
    stored = folder.load(f"losses-{entry.name}", Losses)
    curves = zip(entry.seeds, stored.values, stored.outcomes, strict=True)
    return {
        "-" if seed is None else str(seed): TrainingLoss(
            start=float(losses[0]),
            end=float(losses[-1]),
            decades=float(np.log10(losses[0] / losses[-1])),
            iterations=int(losses.size - 1),
            outcome=str(outcome),
        )
        for seed, losses, outcome in curves
    }


def _own_total(arrays: dict[str, np.ndarray], label: str) -> float:
    """Total error as one step per sample of the plain integrator sees it."""
    difference = arrays[f"{label}/own"] - arrays["truth"]
    return float(np.sqrt(np.mean(difference**2)))


def run(options: ReproduceOptions) -> CommandResult:
    """Run the experiment of the paper, as the command line does."""
    folder = start_run(REPRODUCE, options, options.settings, system="paper")
    rows = reproduce(options.settings, folder)
    metrics = folder.read_metrics("metrics.json", ReproduceMetrics)
    lines = [table2.text(rows), *table2.summary_lines(rows), *metrics.remarks]
    text = "\n".join(lines)
    return CommandResult(metrics, text, folder)
