"""`pinav study paper-weakness`: a fit of one trajectory beside one of several.

The paper's network of position and time fits its single trajectory to many digits.
What it learned of the force, and what it predicts from other starts, stands here beside
a static kernel potential that was fitted to a few noisy crossings of the same barrier.
"""

from collections.abc import Callable

import msgspec
import numpy as np

from pinav.commands.cells import RolloutRow, as_cell, percent
from pinav.commands.held_out import held_out
from pinav.commands.progress import Reporter
from pinav.commands.study.job import clean_data, with_noise
from pinav.commands.study.metrics import ModelScores, WeaknessMetrics
from pinav.commands.study.settings import StudySettings
from pinav.dynamics import AbstractDynamics, Swimmer
from pinav.errors import FitError
from pinav.evaluation import (
    NEAR,
    VISITED,
    ErrorCurve,
    error_curve,
    extent,
    field_map,
    force_agreement,
    position_errors,
    predict,
    score,
    square,
    summarise,
)
from pinav.figures.errors import error_over_time, errors_by_region
from pinav.figures.images import Figures
from pinav.figures.style import new_figure, style_of, title_panel
from pinav.fitting import Outcome, fit_bayes
from pinav.fitting.environments.catalogue import build
from pinav.fitting.environments.choice import ModelChoice, learned_part
from pinav.fitting.environments.summary import summarise_data, summarise_for
from pinav.learning.learned import ModelHeader, build_model, write_model
from pinav.learning.matching import matching
from pinav.learning.recipes import Curriculum, Paper
from pinav.report import Paragraph, Section, Table
from pinav.runs import RunFolder
from pinav.scenarios import paper
from pinav.trajectories import Trajectories, simulate

UDE, KERNEL = "UDE with time, one trajectory", "kernel potential, several"
PHYSICS = "physics only"

STYLES = {
    UDE: style_of("ude"),
    KERNEL: style_of("kernel-potential"),
    PHYSICS: style_of("physics-only"),
}


def weakness(settings: StudySettings, folder: RunFolder) -> WeaknessMetrics:
    """Fit both models, score them and write the results.

    Returns:
        The content of `metrics.json`.

    Raises:
        FitError: a fit diverged.
    """
    single = simulate(paper())
    seed = settings.seeds[0]
    clean = clean_data("barrier-crossings", seed, settings.count)
    several = with_noise(clean, settings.sigma, seed)
    ude = _read_or_fit(folder, "model-ude.eqx", _fit_ude, settings, single)
    kernel = _read_or_fit(folder, "model-kernel.eqx", _fit_kernel, settings, several)
    physics = paper().swimmer
    held = held_out(paper(), until=20.0, count=settings.held_out)
    chosen = {UDE: (ude, single), KERNEL: (kernel, clean), PHYSICS: (physics, single)}
    arrays: dict[str, np.ndarray] = {}
    metrics = WeaknessMetrics(
        models={
            name: _scores(name, model, training, held, arrays)
            for name, (model, training) in chosen.items()
        },
        recipe=settings.recipe,
        seed=seed,
        count=settings.count,
        sigma=settings.sigma,
        held_out=settings.held_out,
        own_trajectory=as_cell(score(*predict(ude, single), single).position),
    )
    folder.write_arrays("results.npz", arrays)
    folder.write_metrics("metrics.json", metrics)
    return metrics


def _read_or_fit(
    folder: RunFolder,
    name: str,
    make: Callable[
        [StudySettings, Trajectories, RunFolder], tuple[ModelHeader, AbstractDynamics]
    ],
    settings: StudySettings,
    data: Trajectories,
) -> AbstractDynamics:
    """The model of a file, fitted first where the file is not there."""
    if not folder.has(name):
        write_model(folder, *make(settings, data, folder), name)
    return folder.read_model(
        name, lambda header: build_model(msgspec.convert(header, ModelHeader), paper())
    )


def _fit_ude(
    settings: StudySettings, data: Trajectories, folder: RunFolder
) -> tuple[ModelHeader, AbstractDynamics]:
    paper_recipe = settings.recipe == "paper"
    choice = ModelChoice("paper-ude" if paper_recipe else "ude", settings.seeds[0])
    summary = summarise_data(data)
    model = build(choice, paper().swimmer, summary)
    recipe = "paper" if paper_recipe else "curriculum"
    steps = Curriculum(settings.max_steps)
    method = matching(Paper() if recipe == "paper" else steps, data, model)
    with Reporter(folder, "ude") as report:
        (result,) = method.fit(
            [model],
            data,
            trainable=learned_part,
            checkpoint=folder.checkpoint("ude"),
            on_chunk=report,
        )
    if result.outcome is Outcome.DIVERGED:
        raise FitError("the fit diverged")
    return ModelHeader(choice, summary, method.precision), result.model


def _fit_kernel(
    settings: StudySettings, data: Trajectories, folder: RunFolder
) -> tuple[ModelHeader, AbstractDynamics]:
    choice = ModelChoice()
    summary = summarise_for(choice, data)
    with Reporter(folder, choice.name) as report:
        result = fit_bayes(
            build(choice, paper().swimmer, summary),
            data,
            max_iterations=settings.max_steps,
            on_step=report,
        )
    summary = summary.with_kernels_of(result.model.environment)
    return ModelHeader(choice, summary), result.model


def _scores(
    name: str,
    model: Swimmer,
    training: Trajectories,
    held: Trajectories,
    arrays: dict[str, np.ndarray],
) -> ModelScores:
    """Force by region of its own training data, and rollouts from held-out starts."""
    limits = square(held)
    learned = field_map(model.environment, training, limits=limits)
    true = field_map(paper().true_swimmer.environment, training, limits=limits)
    agreements = force_agreement(learned, true)
    errors = position_errors(predict(model, held)[0], held, domain=extent(held))
    curve, whole = error_curve(errors), summarise(errors)
    arrays |= curve.as_arrays(f"curve/{name}")
    return ModelScores(
        force={region: as_cell(a.error) for region, a in agreements.items()},
        cosine={region: as_cell(a.cosine) for region, a in agreements.items()},
        rollouts=RolloutRow.of(whole),
    )


def weakness_sections(folder: RunFolder, metrics: WeaknessMetrics) -> list[Section]:
    """The figure and its table."""
    arrays = folder.read_arrays("results.npz")
    figure = new_figure(7.5, 3.6)
    left, right = figure.subplots(1, 2)
    models = metrics.models
    errors_by_region(
        {m: row.force for m, row in models.items()}, styles=STYLES, ax=left
    )
    curves = {name: ErrorCurve.from_arrays(arrays, f"curve/{name}") for name in models}
    error_over_time(curves, styles=STYLES, ax=right)
    title_panel(left, "(a) error of the force by region")
    title_panel(right, f"(b) rollouts from {metrics.held_out} held-out starts")
    return [
        Section(
            "The paper's weakness in one figure",
            [
                Paragraph(_introduction(metrics)),
                Figures(folder.path).image(
                    "paper-weakness",
                    figure,
                    "(a) Relative L2 error of the force; ground counts by its distance "
                    f"to the data that the model was fitted to: visited within "
                    f"{VISITED:g}, near within {NEAR:g}, unvisited farther. (b) Median "
                    "position error (line) and 90th percentile (dotted); a line ends "
                    "where that share has diverged. Synthetic data, dimensionless.",
                    alt="Force error by region and rollout error over time",
                ),
                weakness_table(metrics),
            ],
        )
    ]


def _introduction(metrics: WeaknessMetrics) -> str:
    recipe = {
        "default": "the Gauss-Newton curriculum of pinav, not the paper's optimiser",
        "paper": "the paper's own recipe, Adam and then L-BFGS",
    }[metrics.recipe]
    error = metrics.own_trajectory
    shown = f"{error:.2g}" if isinstance(error, float) else error
    return (
        "The paper's network of position and time, trained on its single trajectory by "
        f"{recipe}, reproduces that trajectory to a position error of {shown}. The "
        f"kernel potential was fitted to {metrics.count} other crossings of the "
        f"same barrier with noise of {metrics.sigma:g}. At a grid point the network "
        "sees the time of its nearest sample, the reading most favourable to it."
    )


def weakness_table(metrics: WeaknessMetrics) -> Table:
    """Force errors in percent and rollout errors of each model."""
    regions = list(next(iter(metrics.models.values())).force)
    rows = [
        (
            name,
            *map(percent, row.force.values()),
            row.rollouts.median,
            row.rollouts.high,
            percent(row.rollouts.diverged),
        )
        for name, row in metrics.models.items()
    ]
    header = ("model", *(f"force {region} (%)" for region in regions))
    header += ("rollouts median", "rollouts 90 %", "diverged (%)")
    return Table(
        header,
        rows,
        "Relative L2 error of the force, and root-mean-square position error of "
        f"rollouts from {metrics.held_out} clean held-out starts: median and 90th "
        "percentile, share farther off than the extent of the domain.",
    )
