"""`pinav study`: how models fare with more data, and with more noise.

Every cell of a study is one fit, made as `pinav fit` would, and scored on clean
trajectories from starts that no fit has seen. A cell that is done is not done again.
"""

import dataclasses
import functools
import math
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import equinox as eqx
import jax
import msgspec

from pinav.commands import STUDY
from pinav.commands.command import CommandResult
from pinav.commands.results import keep
from pinav.commands.settings import ModelName
from pinav.commands.study import StudyOptions, StudySettings
from pinav.commands.sweep import FILE, Sweep, start_sweep, status_text
from pinav.dynamics import AbstractDynamics
from pinav.errors import InputError
from pinav.evaluation import (
    Agreement,
    RolloutSummary,
    default_regions,
    extent,
    field_map,
    force_agreement,
    held_out,
    position_errors,
    predict,
    square,
    summarise,
)
from pinav.figures import Picture
from pinav.figures.errors import scaling_figure
from pinav.fitting.environments.summary import KnownSwimmer
from pinav.learning.learn import infer
from pinav.learning.plan import MATCHED_MODELS, plan_fit
from pinav.learning.recipes import Bayes, Curriculum
from pinav.report import Cell as Entry
from pinav.report import Paragraph, Section, Table
from pinav.runs import RunFolder
from pinav.scenarios import scenario
from pinav.sweeps import Cell, sweep_status
from pinav.systems import System
from pinav.trajectories import GaussianNoise, Trajectories, degrade, simulate

VISITED = "visited"
"""The region whose force error the figure of a study shows."""


@dataclasses.dataclass(frozen=True)
class StudyFit:
    """One fit of a study; one that failed has no scores.

    Attributes:
        seed: seed of starts, noise and network.
        outcome: word for how the fit ended, or why it failed.
        force: agreement with the true force by the distance to the data; none where
            the model has no force.
        rollouts: position errors over held-out starts.
    """

    model: str
    seed: int
    trajectories: int
    sigma: float
    outcome: str
    force: dict[str, Agreement] = dataclasses.field(default_factory=dict)
    rollouts: RolloutSummary | None = None

    def force_error(self, region: str) -> float:
        """Relative L2 error of the force in a region; NaN without a force."""
        return self.force[region].error if self.force else math.nan

    def rollout(self, score: str) -> float:
        """A score of the rollouts, by the name of its field; NaN without one."""
        return math.nan if self.rollouts is None else getattr(self.rollouts, score)


@dataclasses.dataclass(frozen=True)
class Study:
    """All fits of a study.

    Attributes:
        name: `data-efficiency` or `noise`.
        fits: one for each model, seed and amount of data or noise.
    """

    name: str
    scenario: str
    fits: tuple[StudyFit, ...]


COLUMNS: dict[str, Callable[[StudyFit], Entry]] = {
    "model": lambda fit: fit.model,
    "seed": lambda fit: fit.seed,
    "trajectories": lambda fit: fit.trajectories,
    "sigma": lambda fit: fit.sigma,
    "outcome": lambda fit: fit.outcome,
    "force visited": lambda fit: fit.force_error(VISITED),
    "force near": lambda fit: fit.force_error("near"),
    "force unvisited": lambda fit: fit.force_error("unvisited"),
    "cosine visited": lambda fit: fit.force[VISITED].cosine if fit.force else math.nan,
    "rollouts median": lambda fit: fit.rollout("median"),
    "rollouts 90 %": lambda fit: fit.rollout("high"),
    "rollouts diverged": lambda fit: fit.rollout("diverged"),
}
"""Columns of `study.csv`, a published format: errors of the force are fractions."""

QUANTITIES = {
    "data-efficiency": "number of trajectories",
    "noise": "noise of the observations",
}
"""What each study varies."""


def sections(study: Study) -> list[Section]:
    """The figure of a study, and a row for each fit."""
    quantity = QUANTITIES[study.name]
    picture = Picture(
        study.name,
        lambda: scaling_figure(
            _series(study, lambda fit: fit.force_error(VISITED)),
            _series(study, lambda fit: fit.rollout("median")),
            quantity=quantity,
        ),
        "Synthetic data, dimensionless. Lines: median over seeds. A model without "
        "points failed, diverged or has no force; the table says which.",
        alt=f"Force and rollout error over the {quantity}",
    )
    note = Paragraph(
        "Force: relative L2 error on ground within 0.35 of the training data. "
        "Rollouts: median over held-out clean starts of the root-mean-square position "
        "error."
    )
    heading = f"{study.name.capitalize()} on {study.scenario}"
    return [Section(heading, [picture, note, table(study)])]


def _series(
    study: Study, error: Callable[[StudyFit], float]
) -> dict[str, list[tuple[float, float]]]:
    """The points of each model that are numbers."""
    series: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for fit in study.fits:
        place = fit.sigma if study.name == "noise" else float(fit.trajectories)
        points = series[fit.model]
        if math.isfinite(error(fit)):
            points.append((place, error(fit)))
    return series


def table(study: Study) -> Table:
    """All fits of a study, errors of the force in percent."""
    columns: dict[str, Callable[[StudyFit], Entry]] = {}
    for name, cell in COLUMNS.items():
        if name.startswith("force"):
            region = name.removeprefix("force ")
            columns[f"{name} (%)"] = lambda fit, at=region: 100 * fit.force_error(at)
        else:
            columns[name] = cell
    caption = (
        "Relative L2 error of the force by ground, and position errors of rollouts: "
        "median and 90th percentile over held-out starts, share diverged."
    )
    return Table.of(study.fits, columns, caption)


def csv_rows(study: Study) -> list[list[Entry]]:
    """The rows of `study.csv`."""
    rows = [[cell(fit) for cell in COLUMNS.values()] for fit in study.fits]
    return [["diverged" if c == math.inf else c for c in row] for row in rows]


NESTED = 32
"""Trajectories that are simulated for each seed at least: of one shape, compiled once,
of which smaller sets are the first ones."""


class StudyCell(msgspec.Struct, frozen=True):
    """What decides one fit of a study, beside the scenario and the seed."""

    model: ModelName
    count: int
    sigma: float
    held_out: int
    max_steps: int


def cells(name: str, world: str, settings: StudySettings) -> list[Cell]:
    """The fits of a study, small ones first."""
    grid = [(count, settings.sigma) for count in settings.counts]
    if name == "noise":
        grid = [(settings.count, sigma) for sigma in settings.sigmas]
    return [
        Cell.of(
            "pinav.commands.study.job:do_cell",
            StudyCell(model, count, sigma, settings.held_out, settings.max_steps),
            system=world,
            seed=seed,
            label=f"{model}, {count} x {sigma:g}, seed {seed}",
            shape=f"{model} {count}",
        )
        for count, sigma in grid
        for model in settings.models
        for seed in settings.seeds
    ]


def study(name: str, world: str, settings: StudySettings, sweep: Sweep) -> Study:
    """Fit and score every cell."""
    chosen = cells(name, world, settings)
    outcomes = sweep.run(chosen, name)
    fits = (
        _without_scores(cell, f"failed: {outcome.failure}")
        if outcome.failure
        else sweep.result(cell, StudyFit)
        for cell, outcome in zip(chosen, outcomes, strict=True)
    )
    return Study(name, world, tuple(fits))


def _without_scores(cell: Cell, outcome: str) -> StudyFit:
    one = cell.read(StudyCell)
    return StudyFit(one.model, cell.seed, one.count, one.sigma, outcome)


def do_cell(cell: Cell, folder: Path) -> None:
    """Fit and score one cell, and write its row."""
    one, known = cell.read(StudyCell), scenario(cell.system)
    clean = clean_data(cell.system, cell.seed, max(one.count, NESTED))
    clean = clean.select(range(one.count))
    data = with_noise(clean, one.sigma, cell.seed)
    numbers = {"seed": cell.seed, "max_steps": one.max_steps}
    model, outcome = fit_model(one.model, known, data, **numbers)
    held = _held_out(cell.system, one.held_out)
    fit = with_scores(_without_scores(cell, outcome), model, known, clean, held)
    RunFolder(folder).store(FILE, fit)


@functools.lru_cache(maxsize=2)
def _held_out(world: str, count: int) -> Trajectories:
    return held_out(scenario(world), count=count)


def check(name: str, world: str, settings: StudySettings) -> None:
    """Refuse a study before a folder is made for it."""
    counts = (settings.count,) if name == "noise" else settings.counts
    for count in counts:
        chosen = scenario(world, count=count)
        if chosen.thermal_energy is not None:
            raise InputError(
                f"study: system {world!r} is stochastic, so that clean trajectories "
                "to score against do not exist; choose another one"
            )


@functools.lru_cache(maxsize=8)
def clean_data(world: str, seed: int, count: int) -> Trajectories:
    """Noise-free trajectories, from the starts of `pinav simulate --seed`."""
    starts_key, _ = jax.random.split(jax.random.key(seed))
    chosen = scenario(world, starts_key, count=count)
    return simulate(eqx.tree_at(lambda s: s.observation.noise, chosen, 0.0))


def with_noise(clean: Trajectories, sigma: float, seed: int) -> Trajectories:
    """The trajectories as observed; more noise of a seed is the same, only stronger."""
    _, noise_key = jax.random.split(jax.random.key(seed))
    return degrade(clean, [GaussianNoise(sigma)], key=noise_key) if sigma else clean


def fit_model(
    model: ModelName, system: System, data: Trajectories, *, seed: int, max_steps: int
) -> tuple[AbstractDynamics, str]:
    """A model as `pinav fit` fits it, without a structure, and how the fit ended.

    Physics alone has nothing to fit. A fit whose steps ran out is used as it stands.
    """
    if model == "physics-only":
        return system.swimmer.without_environment(), "nothing to fit"
    recipe = Bayes(structure="free", max_steps=max_steps)
    if model in MATCHED_MODELS:
        recipe = Curriculum(max_steps)
    fit = infer(plan_fit(system, data, model=model, recipe=recipe, seed=seed))
    return fit.model, fit.ending


def with_scores(
    fit: StudyFit,
    model: AbstractDynamics,
    known: System,
    training: Trajectories,
    held: Trajectories,
) -> StudyFit:
    """The fit with the errors of its force by region, and of rollouts.

    Args:
        training: what the model was fitted to, without noise: the regions are the same
            for every noise.
    """
    ys, _ = predict(model, held)
    rollouts = summarise(position_errors(ys, held, domain=extent(held)))
    force = {}
    if isinstance(model, KnownSwimmer):
        limits = square(held)
        learned = field_map(model.environment, training, limits=limits)
        true = field_map(known.true_swimmer.environment, training, limits=limits)
        force = force_agreement(learned, true, default_regions(training))
    return dataclasses.replace(fit, force=force, rollouts=rollouts)


def run(options: StudyOptions) -> CommandResult:
    """Run a study as the command line does, or tell how far one is."""
    name, world, settings = options.name, options.scenario, options.settings
    if name == "status":
        status = sweep_status(Path(world))
        return CommandResult(status, status_text(status))
    check(name, world, settings)
    identity = {"study": name, "scenario": world}
    with start_sweep(STUDY, options, options.workers, settings, **identity) as sweep:
        found = study(name, world, settings, sweep)
        sweep.folder.write_table("study.csv", tuple(COLUMNS), csv_rows(found))
        return keep(STUDY, sweep.folder, found)
