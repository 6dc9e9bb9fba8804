"""The paper's weakness: a fit of one trajectory beside one of several.

Run with `python -m benchmarks paper-weakness`. The paper's network of position and time
fits its single trajectory to many digits. What it learned of the force, and what it
predicts from other starts, stands here beside a static kernel potential that was fitted
to a few noisy crossings of the same barrier.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pinav.commands.command import Command, CommandResult
from pinav.commands.dispatch import execute
from pinav.commands.progress import Reporter
from pinav.commands.results import keep, start_run
from pinav.commands.settings import Range, ResumableOptions, Settings
from pinav.commands.study.job import clean_data, with_noise
from pinav.dynamics import AbstractDynamics, Swimmer
from pinav.errors import FitError
from pinav.evaluation import (
    NEAR,
    VISITED,
    Agreement,
    ErrorCurve,
    RolloutSummary,
    error_curve,
    extent,
    field_map,
    force_agreement,
    held_out,
    position_errors,
    predict,
    score,
    square,
    summarise,
)
from pinav.figures.errors import error_over_time
from pinav.figures.images import Picture
from pinav.figures.style import (
    SMALL,
    add_legend,
    label_axes,
    new_figure,
    prepare_axes,
    style_of,
    title_panel,
)
from pinav.fitting import Outcome, fit_bayes
from pinav.fitting.environments.catalogue import build
from pinav.fitting.environments.summary import (
    ModelChoice,
    learned_part,
    summarise_data,
    summarise_for,
)
from pinav.learning.learned import ModelHeader, build_model, read_header, write_model
from pinav.learning.matching import matching
from pinav.learning.recipes import Curriculum, Paper
from pinav.report import Paragraph, Section, Table, number
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


class WeaknessSettings(Settings, frozen=True):
    """Settings of the benchmark.

    Attributes:
        seed: Seed of starts, noise and network.
        count: Number of trajectories that the kernel potential is fitted to.
        sigma: Standard deviation of their observations.
        held_out: Number of clean starts that no model is fitted to.
        max_steps: Steps of each fit, or of each of its windows, at most.
        recipe: How the paper's network is trained; default: Gauss-Newton curriculum,
            paper: Adam, then L-BFGS.
    """

    seed: int = 0
    count: Annotated[int, Range(1)] = 8
    sigma: Annotated[float, Range(0)] = 0.02
    held_out: Annotated[int, Range(1)] = 64
    max_steps: Annotated[int, Range(1)] = 20
    recipe: Literal["default", "paper"] = "default"


class Options(ResumableOptions, frozen=True, kw_only=True):
    """Fit the paper's network to its trajectory and a kernel potential to several."""

    settings: WeaknessSettings = WeaknessSettings()
    out: Path = Path("runs/paper-weakness")


@dataclasses.dataclass(frozen=True)
class ModelScores:
    """What a model learned of the force, and how well it predicts.

    Attributes:
        force: agreement with the true force by region of the model's own data.
        rollouts: position errors from held-out starts.
        curve: the same over time.
    """

    force: dict[str, Agreement]
    rollouts: RolloutSummary
    curve: ErrorCurve


@dataclasses.dataclass(frozen=True)
class Weakness:
    """The scores of both models and of the known physics.

    Attributes:
        settings: how they were fitted.
        models: scores of each model by its name.
        own_trajectory: position error of the network on the trajectory that it knows
            [L].
    """

    settings: WeaknessSettings
    models: dict[str, ModelScores]
    own_trajectory: float


PAPER_WEAKNESS = Command(
    name="paper-weakness",
    call="python -m benchmarks paper-weakness",
    summary="the paper's network on one trajectory beside a kernel potential",
    options="benchmarks.paper_weakness:Options",
    run="benchmarks.paper_weakness:run",
    title="The paper's weakness",
    result="benchmarks.paper_weakness:Weakness",
    file="metrics",
    sections="benchmarks.paper_weakness:sections",
    resumable=True,
)


def main(argv: Sequence[str]) -> None:
    """Fit both models, print their scores and write a report."""
    execute(PAPER_WEAKNESS, argv)


def run(options: Options) -> CommandResult:
    """Fit both models, unless a run that is resumed has them, and score them."""
    folder = start_run(PAPER_WEAKNESS, options, options.settings)
    return keep(PAPER_WEAKNESS, folder, weakness(options.settings, folder))


def weakness(settings: WeaknessSettings, folder: RunFolder) -> Weakness:
    """Fit both models and score them.

    Raises:
        FitError: a fit diverged.
    """
    single = simulate(paper())
    clean = clean_data("barrier-crossings", settings.seed, settings.count)
    several = with_noise(clean, settings.sigma, settings.seed)
    ude = _read_or_fit(folder, "model-ude.eqx", _fit_ude, settings, single)
    kernel = _read_or_fit(folder, "model-kernel.eqx", _fit_kernel, settings, several)
    physics = paper().swimmer
    held = held_out(paper(), until=20.0, count=settings.held_out)
    chosen = {UDE: (ude, single), KERNEL: (kernel, clean), PHYSICS: (physics, single)}
    scores = {
        name: _scores(model, data, held) for name, (model, data) in chosen.items()
    }
    own = score(*predict(ude, single), single).position
    return Weakness(settings, scores, float(own))


Make = Callable[
    [WeaknessSettings, Trajectories, RunFolder],
    tuple[ModelHeader, AbstractDynamics],
]
"""A fit of a model to data, with the reports of its steps in a run."""


def _read_or_fit(
    folder: RunFolder,
    name: str,
    make: Make,
    settings: WeaknessSettings,
    data: Trajectories,
) -> AbstractDynamics:
    """The model of a file, fitted first where the file is not there."""
    if not folder.has(name):
        write_model(folder, *make(settings, data, folder), name)
    return folder.read_model(
        name, lambda header: build_model(read_header(header), paper())
    )


def _fit_ude(
    settings: WeaknessSettings, data: Trajectories, folder: RunFolder
) -> tuple[ModelHeader, AbstractDynamics]:
    paper_recipe = settings.recipe == "paper"
    choice = ModelChoice("paper-ude" if paper_recipe else "ude", settings.seed)
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
    settings: WeaknessSettings, data: Trajectories, folder: RunFolder
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
    return ModelHeader(choice, summary.of_fit(result.model)), result.model


def _scores(model: Swimmer, training: Trajectories, held: Trajectories) -> ModelScores:
    """Force by region of its own training data, and rollouts from held-out starts."""
    limits = square(held)
    learned = field_map(model.environment, training, limits=limits)
    true = field_map(paper().true_swimmer.environment, training, limits=limits)
    errors = position_errors(predict(model, held)[0], held, domain=extent(held))
    return ModelScores(
        force_agreement(learned, true), summarise(errors), error_curve(errors)
    )


def sections(result: Weakness) -> list[Section]:
    """The figure and its table."""
    held = result.settings.held_out
    picture = Picture(
        "paper-weakness",
        lambda: weakness_figure(result),
        "(a) Relative L2 error of the force; ground counts by its distance to the data "
        f"that the model was fitted to: visited within {VISITED:g}, near within "
        f"{NEAR:g}, unvisited farther. (b) Median position error (line) and 90th "
        "percentile (dotted); a line ends where that share has diverged. Synthetic "
        "data, dimensionless.",
        alt="Force error by region and rollout error over time",
    )
    regions = list(next(iter(result.models.values())).force)
    header = ("model", *(f"force {region} (%)" for region in regions))
    header += ("rollouts median", "rollouts 90 %", "diverged (%)")
    rows = [
        (
            name,
            *(_percent(one.error) for one in scores.force.values()),
            scores.rollouts.median,
            scores.rollouts.high,
            100 * scores.rollouts.diverged,
        )
        for name, scores in result.models.items()
    ]
    note = (
        "Relative L2 error of the force, and root-mean-square position error of "
        f"rollouts from {held} clean held-out starts: median and 90th percentile, "
        "share farther off than the extent of the domain."
    )
    blocks = [Paragraph(_introduction(result)), picture, Table(header, rows, note)]
    return [Section("The paper's weakness in one figure", blocks)]


def _percent(fraction: float) -> float | None:
    """Percent; none where there is no ground of the kind."""
    return None if fraction != fraction else 100 * fraction


def errors_by_region(scores: Mapping[str, ModelScores], ax: Axes) -> None:
    """Bars of the relative force error in each region, one colour for each model."""
    prepare_axes(ax)
    regions = list(next(iter(scores.values())).force)
    width = 0.8 / len(scores)
    for index, (name, one) in enumerate(scores.items()):
        x = np.arange(len(regions)) + width * (index - (len(scores) - 1) / 2)
        heights = [100 * one.force[region].error for region in regions]
        ax.bar(x, heights, 0.92 * width, color=STYLES[name].color, label=name)
        for at, height in zip(x, heights, strict=True):
            if np.isfinite(height):
                label = f"{height:.2g}" if height < 100 else f"{height:.0f}"
                ax.text(at, height, label, ha="center", va="bottom", fontsize=SMALL)
    ax.set_yscale("log")
    ax.tick_params(which="both", labelsize=SMALL)
    ax.set_xticks(np.arange(len(regions)), regions)
    label_axes(ax, "region", "relative force error (%)")
    low, high = ax.get_ylim()
    ax.set_ylim(low, 30 * high)  # room for the legend
    add_legend(ax, loc="upper left")


def weakness_figure(result: Weakness) -> Figure:
    """Errors of the force by region, and of rollouts over time, of each model."""
    figure = new_figure(7.5, 3.6)
    left, right = figure.subplots(1, 2)
    errors_by_region(result.models, left)
    curves = {name: scores.curve for name, scores in result.models.items()}
    error_over_time(curves, styles=STYLES, ax=right)
    title_panel(left, "(a) error of the force by region")
    held = result.settings.held_out
    title_panel(right, f"(b) rollouts from {held} held-out starts")
    return figure


def _introduction(result: Weakness) -> str:
    recipe = {
        "default": "the Gauss-Newton curriculum of pinav, not the paper's optimiser",
        "paper": "the paper's own recipe, Adam and then L-BFGS",
    }[result.settings.recipe]
    return (
        "The paper's network of position and time, trained on its single trajectory by "
        f"{recipe}, reproduces that trajectory to a position error of "
        f"{number(result.own_trajectory, 2)}. The kernel potential was fitted to "
        f"{result.settings.count} other crossings of the same barrier with noise of "
        f"{result.settings.sigma:g}. At a grid point the network sees the time of its "
        "nearest sample, the reading most favourable to it."
    )
