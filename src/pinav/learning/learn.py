"""`pinav.learn`: a model of the unknown, fitted by the recipe that suits the data."""

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import msgspec

from pinav import fitting
from pinav.errors import FitError
from pinav.fitting.environments.catalogue import build
from pinav.fitting.environments.summary import MIXTURE
from pinav.fitting.evidence.model_evidence import model_evidence
from pinav.forces import AbstractForce, as_learned_force
from pinav.identification import fit_commanded, needs_kalman_filter
from pinav.identification.parameters import BLOCK_NOISE
from pinav.learning.account import account
from pinav.learning.evidence import SearchResult
from pinav.learning.learned import (
    MODEL,
    Learned,
    ModelHeader,
    of_evidence,
    teacher_choice,
)
from pinav.learning.matching import Losses, matching
from pinav.learning.plan import FitPlan, choose_system, plan_fit
from pinav.learning.recipes import SUITED, Bayes, Curriculum, Langevin, Paper, Recipe
from pinav.learning.thermal import fit_thermal
from pinav.systems import System
from pinav.trajectories import Trajectories

DIVERGED = (
    "the fit diverged: the states depart from the dynamics of the system; check its "
    "propulsion, drag and units (--system), or fit shorter trajectories"
)

NO_GRADIENT = (
    "; a rotational force, such as that of a vortex, is no gradient of a potential: "
    "choose --model kernel-mixture for it"
)


@dataclasses.dataclass(frozen=True)
class RoundProgress:
    """Progress of a fit beside commands after each round."""

    done: int
    log_likelihood: float
    field: bool = True


Progress = fitting.EvidenceProgress | fitting.FitProgress | RoundProgress

OnProgress = Callable[[Progress], None]


def learn(
    system: System | str | None,
    data: Any,
    *,
    model: str | None = None,
    recipe: Recipe = SUITED,
    train: tuple[str, ...] = (),
    seed: int = 0,
    width: int = 32,
    depth: int = 2,
    checkpoint: fitting.AbstractCheckpoint | None = None,
    on_progress: OnProgress | None = None,
) -> Learned:
    """Learn the unknown force on a swimmer, as `pinav fit` does.

        learned = pinav.learn("my.toml", table)
        learned.force([[5.0, 5.0]]), learned.constants, learned.remarks
        learned.save("run")

    Args:
        system: what is known of the swimmer: a `System`, a system file, or the name of
            a built-in system; the one that simulated data come from unless given.
        data: `Trajectories`, or a table of pandas or polars with columns as in CSV
            files.
        model: name of what stands for the unknown; chosen by system and data unless
            given.
        recipe: how it is fitted; what suits the data unless given. See
            `pinav.learning.recipes`.
        train: known constants to learn beside the unknown: damping, gain or drag.
        width: neurons of each of the hidden layers of a network.
        checkpoint: where trajectory matching keeps its state and goes on from it.
        on_progress: called after each step or chunk.

    Returns:
        The fit, its constants with units and intervals, and what limits it.

    Raises:
        InputError: system and data do not fit together, or the recipe cannot use them.
        FitError: the fit diverged, or the data do not determine it.
    """
    if not isinstance(data, Trajectories):
        data = Trajectories.from_table(data)
    if not isinstance(system, System):
        system = choose_system(system, data)
    with jax.enable_x64(new_val=True):
        network = {"seed": seed, "width": width, "depth": depth}
        plan = plan_fit(
            system, data, model=model, recipe=recipe, train=train, **network
        )
        fit = infer(plan, checkpoint=checkpoint, on_progress=on_progress)
        return dataclasses.replace(fit, found=account(plan, fit))


def open_run(path: Path | str) -> Learned:
    """The fit that a folder holds: by `Learned.save`, or by `pinav fit --out`.

    Raises:
        InputError: the folder holds no run or no model, or a file is damaged.
    """
    with jax.enable_x64(new_val=True):
        return Learned.open(path)


def infer(
    plan: FitPlan,
    *,
    checkpoint: fitting.AbstractCheckpoint | None = None,
    on_progress: OnProgress | None = None,
) -> Learned:
    """The fit of a plan, without an account of it; see `learn`."""
    model: Any = build(plan.choice, plan.system.swimmer, plan.summary)
    header = ModelHeader(plan.choice, plan.summary)
    if isinstance(plan.recipe, Langevin):
        assert plan.thermal is not None  # planned for this recipe
        result, thermal = fit_thermal(plan.thermal, model, plan.system, plan.data)
        fit = of_evidence(header, result, plan.system, plan.data)
        return dataclasses.replace(fit, thermal=thermal)
    if not isinstance(plan.recipe, Bayes):
        return _match(plan, model, checkpoint, on_progress)
    if needs_kalman_filter(plan.system):
        result, support = _fit_commanded(plan, model.environment, on_progress)
        return of_evidence(header, result, plan.system, plan.data, support=support)
    return _infer_force(plan, model, header, on_progress)


def _infer_force(
    plan: FitPlan, model: Any, header: ModelHeader, on_progress: OnProgress | None
) -> Learned:
    """Fit by the evidence, with a search for structure where data are worth it."""
    recipe = plan.recipe
    assert isinstance(recipe, Bayes)
    options = {
        "learn": plan.choice.constants,
        "noise": recipe.noise,
        "max_iterations": recipe.max_steps,
        "on_step": on_progress,
        "throw": False,
    }
    weighs = plan.is_open and fitting.may_turn(model)
    teacher = search = None
    if recipe.structure == "search" and (
        weighs or fitting.is_worth_a_search(model, plan.data)
    ):
        budget = math.inf if recipe.budget is None else recipe.budget
        structured = fitting.fit_structured(
            model, plan.data, weigh_rotation=plan.is_open, budget=budget, **options
        )
        result, teacher = structured.fit, structured.teacher
        if not fitting.is_network(model) or teacher is not None:
            search = SearchResult(
                structured.gain, structured.rotation, structured.trace
            )
    else:
        result = fitting.fit_bayes(model, plan.data, **options)
    if result.outcome is fitting.Outcome.DIVERGED:
        force = as_learned_force(model.environment)
        gradient = force is not None and force.is_conservative
        raise FitError(DIVERGED + (NO_GRADIENT if gradient else ""))
    learned = as_learned_force(result.model.environment)
    if learned is not None and learned.helmholtz is not None:
        choice = msgspec.structs.replace(plan.choice, name=MIXTURE)
        header = dataclasses.replace(header, choice=choice)
    fit = of_evidence(header, result, plan.system, plan.data, search)
    if teacher is None or search is None:
        return fit
    choice = teacher_choice(teacher, header.choice)
    header = dataclasses.replace(header, choice=choice)
    kernels = of_evidence(header, teacher, plan.system, plan.data, search)
    return fit.with_teacher(kernels)


def _fit_commanded(
    plan: FitPlan, environment: AbstractForce, on_progress: OnProgress | None
) -> tuple[fitting.EvidenceFit, float | None]:
    """Fit a field beside commands and a wandering velocity; its evidence over none."""
    field, support = as_learned_force(environment), None

    def note(done: int, likelihood: float, *, field: bool = True) -> None:
        if on_progress is not None:
            on_progress(RoundProgress(done, likelihood, field))

    result = fit_commanded(plan.system, plan.data, field, on_round=note)
    if field is not None:
        alone = fit_commanded(
            plan.system,
            plan.data,
            None,
            on_round=lambda done, likelihood: note(done, likelihood, field=False),
        )
        support = _log_evidence(result) - _log_evidence(alone)
    # The residuals are whitened, so that their noise is 1; a run keeps the system's,
    # or where that states none what the fit found for the mean of a block.
    noise = plan.system.observation.noise
    if noise == 0:
        noise = result.constants[BLOCK_NOISE].value
    chosen = dataclasses.replace(result.hyperparameters, noise=noise)
    return dataclasses.replace(result, hyperparameters=chosen), support


def _log_evidence(fit: fitting.EvidenceFit) -> float:
    return model_evidence(fit.linear, fit.hyperparameters).log_evidence


def _match(
    plan: FitPlan,
    model: Any,
    checkpoint: fitting.AbstractCheckpoint | None,
    on_progress: OnProgress | None,
) -> Learned:
    assert isinstance(plan.recipe, Curriculum | Paper)
    method = matching(plan.recipe, plan.data, model)
    (result,) = method.fit(
        [model],
        plan.data,
        trainable=plan.choice.trainable,
        checkpoint=checkpoint,
        on_chunk=on_progress,
    )
    if result.outcome is fitting.Outcome.DIVERGED:
        raise FitError(DIVERGED)
    return Learned(
        None,
        plan.system,
        plan.data,
        {MODEL: result.model},
        plan.choice,
        None,
        header=ModelHeader(plan.choice, plan.summary, method.precision),
        losses=Losses.of([result]),
    )
