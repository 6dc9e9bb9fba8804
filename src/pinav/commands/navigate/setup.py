"""The navigation problem of a run: a task, and what is known of it."""

import dataclasses

import jax
import numpy as np

from pinav.commands.navigate import NAVIGATE
from pinav.commands.navigate.settings import NavigateSettings
from pinav.commands.steering import task_of
from pinav.dynamics import (
    AbstractDynamics,
    OverdampedSwimmer,
    Swimmer,
    takes_commands,
)
from pinav.errors import InputError
from pinav.evaluation import enclosing_cube
from pinav.learning.learned import Learned
from pinav.navigation import Evidence, NavigationProblem, SteeredSwimmer
from pinav.scenarios import source_system
from pinav.units import with_order


def navigation_problem(settings: NavigateSettings, run: Learned) -> NavigationProblem:
    """The navigation problem of a run, from its system and model alone.

    Raises:
        InputError: the run holds no fitted swimmer in the plane or in space, or the
            settings name places of another dimension.
    """
    model, dim = run.model, run.data.dim
    if not isinstance(model, Swimmer | OverdampedSwimmer) or dim < 2:
        raise InputError(
            f"{run.folder.path}: expected a swimmer in the plane or in space, got the "
            f"model {run.choice.name} of {', '.join(run.data.channels)}"
        )
    settings.check_dimension(dim)
    known, truth, source = model, None, source_system(run.data.provenance)
    if source is not None and source.environment is not None:
        known, truth = source.true_swimmer, source.name
    corners = np.array(enclosing_cube(run.data))
    task = task_of(settings, model, known, corners, NAVIGATE.name)
    actuator = task.truth.actuator
    return NavigationProblem(
        task=dataclasses.replace(task, sensor_noise=settings.sensor_noise),
        model=SteeredSwimmer(model, actuator),
        samples=tuple(
            SteeredSwimmer(draw, actuator)
            for draw in _draws(run, settings)
            if isinstance(draw, Swimmer | OverdampedSwimmer)
        ),
        truth=truth,
        evidence=_evidence(run, model),
        data=run.data,
        units=dict(
            with_order(run.data.units, run.system.order, run.system.base_units.force)
        ),
    )


def _draws(run: Learned, settings: NavigateSettings) -> list[AbstractDynamics]:
    if run.posterior is None or settings.samples == 0:
        return []
    key = jax.random.fold_in(jax.random.key(settings.seed), 1)
    return run.posterior.samples(settings.samples, key=key)


def _evidence(run: Learned, model: AbstractDynamics) -> Evidence | None:
    """The fit's evidence where the next trajectory can be suggested.

    Not of stochastic paths, whose states are not smoothed, nor in space, where
    candidates have no elevation.
    """
    evidence, posterior = run.evidence, run.posterior
    if evidence is None or posterior is None:
        return None
    if "diffusion" in evidence.constants or takes_commands(model):
        return None
    if run.data.dim > 2:
        return None
    return Evidence(posterior, run.noise, evidence.states)
