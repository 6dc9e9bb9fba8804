"""`pinav study`: how models fare with more data, and with more noise.

Every cell of a study is one fit, made as `pinav fit` would, and scored on clean
trajectories from starts that no fit has seen. A cell that is done is not done again.
"""

import time
from collections.abc import Iterator

import equinox as eqx
import jax
import msgspec
from tqdm import tqdm

from pinav.commands.cells import as_cell
from pinav.commands.held_out import held_out
from pinav.commands.matching import CurriculumSettings, matching
from pinav.commands.study.metrics import (
    HEADER,
    DataEfficiencyMetrics,
    FinishedCells,
    NoiseMetrics,
    StudyRow,
)
from pinav.commands.study.settings import StudyModel, StudySettings
from pinav.commands.study.stochastic_force_inference import infer_force
from pinav.dynamics import AbstractDynamics
from pinav.errors import FitError, InputError
from pinav.evaluation import (
    default_regions,
    extent,
    field_map,
    force_agreement,
    position_errors,
    predict,
    square,
    summarise,
)
from pinav.fitting import Outcome, fit_bayes
from pinav.fitting.environments.catalogue import (
    KnownSwimmer,
    ModelChoice,
    build,
    summarise_data,
    summarise_for,
)
from pinav.runs import RunFolder
from pinav.scenarios import scenario
from pinav.systems import System
from pinav.trajectories import GaussianNoise, Trajectories, degrade, simulate

ROWS = "rows.json"


class Cell(eqx.Module):
    """One fit of a study.

    Attributes:
        model: name of the model.
        seed: of starts, noise and network.
        count: number of trajectories.
        sigma: standard deviation of the observations.
    """

    model: StudyModel
    seed: int
    count: int
    sigma: float

    @property
    def label(self) -> str:
        """What tells it from the other cells."""
        return f"{self.model}, {self.count} x {self.sigma:g}, seed {self.seed}"


def cells(name: str, settings: StudySettings) -> Iterator[Cell]:
    """The fits of a study, small ones first."""
    grid = [(count, settings.sigma) for count in settings.counts]
    if name == "noise":
        grid = [(settings.count, sigma) for sigma in settings.sigmas]
    for count, sigma in grid:
        for model in settings.models:
            for seed in settings.seeds:
                yield Cell(model, seed, count, sigma)


def study(
    name: str, world: str, settings: StudySettings, folder: RunFolder
) -> DataEfficiencyMetrics | NoiseMetrics:
    """Fit and score every cell, and write the table.

    Args:
        name: `data-efficiency` or `noise`.
        world: name of the scenario.
        settings: which models, seeds and data.
        folder: the run; what it holds is not done again.

    Returns:
        The content of `metrics.json`.

    Raises:
        InputError: the scenario is unknown, or of a kind that `pinav fit` cannot use.
    """
    known = scenario(world)
    rows = folder.read_metrics(ROWS, FinishedCells).rows if folder.has(ROWS) else {}
    clean = held_out(scenario(world), count=settings.held_out)
    chosen = list(cells(name, settings))
    most = max(cell.count for cell in chosen)
    several = {seed: clean_data(world, seed, most) for seed in settings.seeds}
    with tqdm(chosen, desc=name, unit="cell", dynamic_ncols=True) as bar:
        for cell in bar:
            bar.set_postfix_str(cell.label)
            if cell.label not in rows:
                began = time.perf_counter()
                rows[cell.label] = _row(
                    cell, known, several[cell.seed], clean, settings
                )
                folder.write_metrics(ROWS, FinishedCells(rows))
                seconds = round(time.perf_counter() - began, 2)
                folder.append_record({"model": cell.label, "seconds": seconds})
    table = tuple(rows[cell.label] for cell in chosen)
    folder.write_table(
        "study.csv",
        HEADER,
        [["" if v is None else v for v in msgspec.structs.astuple(r)] for r in table],
    )
    kind = NoiseMetrics if name == NoiseMetrics.name else DataEfficiencyMetrics
    metrics = kind(world, table)
    folder.write_metrics("metrics.json", metrics)
    return metrics


def check(name: str, world: str, settings: StudySettings) -> None:
    """Refuse a study before a folder is made for it.

    Raises:
        InputError: the scenario is unknown, stochastic or has too few starts.
    """
    if name == "paper-weakness":
        return
    for cell in cells(name, settings):
        chosen = scenario(world, count=cell.count)
        if chosen.thermal_energy is not None:
            raise InputError(
                f"study: system {world!r} is stochastic, so that clean trajectories "
                "to score against do not exist; choose another one"
            )


def clean_data(world: str, seed: int, count: int) -> Trajectories:
    """Noise-free trajectories, from the starts of `pinav simulate --seed`.

    Args:
        world: name of the scenario.
        seed: of the starts.
        count: how many; more of a seed begin with the same ones.
    """
    starts_key, _ = jax.random.split(jax.random.key(seed))
    chosen = scenario(world, starts_key, count=count)
    return simulate(eqx.tree_at(lambda s: s.observation.noise, chosen, 0.0))


def with_noise(clean: Trajectories, sigma: float, seed: int) -> Trajectories:
    """The trajectories as observed; more noise of a seed is the same noise, stronger.

    Args:
        clean: without noise.
        sigma: standard deviation of the noise, in every state.
        seed: of the noise.
    """
    _, noise_key = jax.random.split(jax.random.key(seed))
    return degrade(clean, [GaussianNoise(sigma)], key=noise_key) if sigma else clean


def _row(
    cell: Cell,
    known: System,
    several: Trajectories,
    held: Trajectories,
    settings: StudySettings,
) -> StudyRow:
    clean = several.select(range(cell.count))
    data = with_noise(clean, cell.sigma, cell.seed)
    row = StudyRow(cell.model, cell.seed, cell.count, cell.sigma)
    try:
        model, outcome = _fitted(cell, settings, known, data)
    except FitError as error:
        return msgspec.structs.replace(row, outcome=f"failed: {error}")
    row = msgspec.structs.replace(row, outcome=outcome)
    return with_scores(row, model, known, clean, held)


def _fitted(
    cell: Cell, settings: StudySettings, known: System, data: Trajectories
) -> tuple[AbstractDynamics, str]:
    if cell.model == "sfi":
        swimmer = infer_force(known.swimmer, data, cell.sigma)
        return swimmer, "functions selected by PASTIS"
    choice = ModelChoice(cell.model, seed=cell.seed)
    return fit_choice(choice, known.swimmer, data, max_steps=settings.max_steps)


def fit_choice(
    choice: ModelChoice, swimmer: KnownSwimmer, data: Trajectories, *, max_steps: int
) -> tuple[AbstractDynamics, str]:
    """A model as `pinav fit` fits it, and how the fit ended.

    Physics alone has nothing to fit. A fit whose steps ran out is used as it stands.

    Args:
        choice: the model.
        swimmer: the known physics.
        data: the trajectories.
        max_steps: of each fit, or of each of its windows.

    Raises:
        FitError: the fit failed.
    """
    if choice.name == "physics-only":
        return swimmer.without_environment(), "nothing to fit"
    if choice.name not in ("ude", "nn-only"):
        start = build(choice, swimmer, summarise_for(choice, data))
        result = fit_bayes(start, data, max_iterations=max_steps, throw=False)
    else:
        model = build(choice, swimmer, summarise_data(data))
        method = matching(CurriculumSettings(max_steps=max_steps), data, model)
        (result,) = method.fit(
            [model],
            data,
            trainable=choice.trainable,
        )
    if result.outcome is Outcome.DIVERGED:
        raise FitError("the fit diverged")
    return result.model, str(result.outcome)


def with_scores(
    row: StudyRow,
    model: AbstractDynamics,
    known: System,
    training: Trajectories,
    held: Trajectories,
) -> StudyRow:
    """The row with the errors of the force by region, and of rollouts.

    Args:
        row: of the table.
        model: a fitted one.
        known: the scenario, whose force is the truth.
        training: what the model was fitted to, without noise: the regions are the same
            for every noise.
        held: clean trajectories to predict; the grid is the square around them.
    """
    ys, _ = predict(model, held)
    whole = summarise(position_errors(ys, held, domain=extent(held)))
    row = msgspec.structs.replace(
        row,
        rollouts_median=as_cell(whole.median),
        rollouts_high=as_cell(whole.high),
        rollouts_diverged=as_cell(whole.diverged),
    )
    if not isinstance(model, KnownSwimmer):
        return row
    limits = square(held)
    learned = field_map(model.environment, training, limits=limits)
    true = field_map(known.true_swimmer.environment, training, limits=limits)
    agreements = force_agreement(learned, true, default_regions(training))
    return msgspec.structs.replace(
        row,
        force_visited=as_cell(agreements["visited"].error),
        force_near=as_cell(agreements["near"].error),
        force_unvisited=as_cell(agreements["unvisited"].error),
        cosine_visited=as_cell(agreements["visited"].cosine),
    )
