"""`pinav reproduce`: the paper's experiment, from nothing to its table and figures."""

import dataclasses

import numpy as np

from pinav.commands import REPRODUCE
from pinav.commands.command import CommandResult
from pinav.commands.progress import Reporter
from pinav.commands.reproduce import ReproduceOptions, ReproduceSettings
from pinav.commands.reproduce.sections import (
    HEADER,
    ModelRollout,
    Reproduction,
    csv_row,
    label_of,
)
from pinav.commands.results import keep, start_run
from pinav.dynamics import AbstractDynamics, FixedStep, Swimmer
from pinav.evaluation import decompose, field_map, predict, score
from pinav.fitting.environments.catalogue import build
from pinav.fitting.environments.summary import (
    ModelChoice,
    learned_part,
    summarise_for_matching,
)
from pinav.learning.learned import Learned, ModelHeader, write_model
from pinav.learning.matching import Losses, matching
from pinav.learning.plan import write_system_of
from pinav.learning.recipes import Curriculum, Paper
from pinav.runs import RunFolder
from pinav.scenarios import scenario
from pinav.systems import System
from pinav.trajectories import Trajectories, load, save, simulate


@dataclasses.dataclass(frozen=True)
class TrainedKind:
    """One kind of model that is trained, for all its seeds.

    Attributes:
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
        return [label_of(self.name, seed) for seed in self.seeds]


def entries(settings: ReproduceSettings) -> list[TrainedKind]:
    """What the recipe trains."""
    return [
        TrainedKind(
            name, (None,) if model.startswith("kernel-") else settings.seeds, model
        )
        for name, model in REPRODUCED[settings.recipe].items()
    ]


REPRODUCED = {
    "paper": {"ude": "paper-ude", "nn-only": "paper-nn-only"},
    "default": {"ude": "ude", "nn-only": "nn-only", "ude-kernel": "kernel-potential"},
}
"""Models of each recipe, by the name of their row in Table 2."""


def reproduce(settings: ReproduceSettings, folder: RunFolder) -> Reproduction:
    """Simulate the benchmark, train the models and score them.

    Whatever the folder already holds is not computed again.
    """
    benchmark = scenario("paper")
    write_system_of(folder, benchmark)
    if not folder.has("data.npz"):
        save(simulate(benchmark), folder.path / "data.npz")
    data = load(folder.path / "data.npz")
    chosen = entries(settings)
    for entry in chosen:
        if not all(folder.has(model_file(label)) for label in entry.labels()):
            _write_fits(entry, settings, data, folder)
    return _evaluate(settings, benchmark, data, folder)


def model_file(label: str) -> str:
    """Name of the file that holds a trained model."""
    return f"model-{label}.eqx"


def _write_fits(
    entry: TrainedKind,
    settings: ReproduceSettings,
    data: Trajectories,
    folder: RunFolder,
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
    settings: ReproduceSettings,
    benchmark: System,
    data: Trajectories,
    folder: RunFolder,
) -> Reproduction:
    """Score every model, before and after training."""
    fitted, chosen = Learned.open(folder.path), entries(settings)
    rollouts = [_rollout("physics-only", None, benchmark.swimmer, data)]
    trained: dict[str, AbstractDynamics] = {}
    for entry in chosen:
        summary = summarise_for_matching(entry.choice(None), benchmark.swimmer, data)
        for seed, label in zip(entry.seeds, entry.labels(), strict=True):
            before = build(entry.choice(seed), benchmark.swimmer, summary)
            trained[label] = fitted.models[f"model-{label}"]
            rollouts.append(_rollout(f"{entry.name}-untrained", seed, before, data))
            rollouts.append(_rollout(entry.name, seed, trained[label], data))
    truth = benchmark.true_swimmer
    assert isinstance(truth, Swimmer)
    times, states = data.times[0], data.states[0]
    swimmers = {n: one for n, one in trained.items() if isinstance(one, Swimmer)}
    maps = {n: field_map(one.environment, data) for n, one in swimmers.items()}
    return Reproduction(
        settings=settings,
        times=times,
        truth=states,
        rollouts=tuple(rollouts),
        losses={e.name: folder.load(f"losses-{e.name}", Losses) for e in chosen},
        own_integrator_total={n: _own_total(one, data) for n, one in trained.items()},
        true_field=field_map(truth.environment, data),
        forces={name: one.force for name, one in maps.items()},
        true_force=decompose(truth, times, states).terms["environment"],
        parts={n: decompose(one, times, states) for n, one in swimmers.items()},
    )


def _rollout(
    model: str, seed: int | None, dynamics: AbstractDynamics, data: Trajectories
) -> ModelRollout:
    predictions, outcomes = predict(dynamics, data)
    errors = score(predictions, outcomes, data).by_name()
    return ModelRollout(model, seed, errors, predictions[0])


def _own_total(dynamics: AbstractDynamics, data: Trajectories) -> float:
    """Total error as one step per sample of the plain integrator sees it."""
    integrated, _ = predict(dynamics, data, solver=FixedStep())
    return float(np.sqrt(np.mean((integrated[0] - data.states[0]) ** 2)))


def run(options: ReproduceOptions) -> CommandResult:
    """Run the experiment of the paper, as the command line does."""
    folder = start_run(REPRODUCE, options, options.settings, system="paper")
    result = reproduce(options.settings, folder)
    folder.write_table("table2.csv", HEADER, [csv_row(row) for row in result.table2])
    return keep(REPRODUCE, folder, result)
