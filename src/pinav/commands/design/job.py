"""`pinav design`: what to record next, until a way is known."""

import itertools
from collections.abc import Mapping

import jax
import numpy as np
from tqdm import tqdm

from pinav.commands.command import CommandResult
from pinav.commands.data_file import read_data
from pinav.commands.design import DESIGN
from pinav.commands.design.settings import DesignOptions, DesignSettings
from pinav.commands.recording_settings import RecordingSettings
from pinav.commands.results import fingerprint, keep, start_run
from pinav.commands.steering import known_task, observe_positions, system_task
from pinav.errors import InputError
from pinav.navigation import AdaptiveController, Course, Experiment, Rectangle, Task
from pinav.navigation.adaptive.flight import map_belief
from pinav.navigation.adaptive.strategies import MeanForce
from pinav.navigation.design.campaign import (
    Campaign,
    believe_data,
    decide,
    record_positions,
    run_campaign,
)
from pinav.navigation.design.candidates import (
    AbstractDesign,
    GridDesign,
    InformedDesign,
    RandomDesign,
    Stage,
    suggest_next,
)
from pinav.navigation.design.result import (
    CampaignSummary,
    DesignResult,
)
from pinav.runs import RunFolder
from pinav.scenarios import find_system
from pinav.systems import System
from pinav.trajectories import concatenate

DESIGNS: Mapping[str, AbstractDesign] = {
    "informed": InformedDesign(),
    "random": RandomDesign(),
    "grid": GridDesign(),
}
"""What `--designs` names."""


def run(options: DesignOptions) -> CommandResult:
    """Design experiments as the command line does."""
    settings, system = options.settings, find_system(options.system)
    work = _suggest if options.data else _compare
    return keep(DESIGN, *work(options, settings, system))


def _compare(
    options: DesignOptions, settings: DesignSettings, system: System
) -> tuple[RunFolder, DesignResult]:
    """Simulated campaigns of each design, in pairs of the same noise."""
    task = system_task(settings, system)
    adaptive = _adaptive(task, settings)
    experiment = _experiment(settings, adaptive)
    folder = start_run(DESIGN, options, settings, system=options.system)
    campaigns: dict[str, list[Campaign]] = {name: [] for name in settings.designs}
    work = list(itertools.product(range(settings.seeds), campaigns))
    for index, name in tqdm(work, desc="campaigns", unit="campaign"):
        key = jax.random.fold_in(jax.random.key(settings.seed), index)
        campaign = run_campaign(
            adaptive,
            DESIGNS[name],
            experiment,
            accuracy=settings.accuracy,
            most=settings.most,
            key=key,
        )
        campaigns[name].append(campaign)
    first, *_ = next(iter(campaigns.values()))
    return folder, DesignResult(
        system=system.name,
        accuracy=settings.accuracy,
        course=Course.of(task),
        maps=map_belief(task, first.belief),
        decision=first.decisions[-1],
        thrust=adaptive.thrust,
        paths={name: some[0].paths for name, some in campaigns.items()},
        designs={name: CampaignSummary.of(some) for name, some in campaigns.items()},
        bounds={
            name: tuple(
                np.array([min(decision.error, 1.0) for decision in one.decisions])
                for one in some
            )
            for name, some in campaigns.items()
        },
    )


def _suggest(
    options: DesignOptions, settings: DesignSettings, system: System
) -> tuple[RunFolder, DesignResult]:
    """The knowledge of recordings, and the trajectory to record next."""
    parts = [read_data(path, RecordingSettings()) for path in options.data]
    data = concatenate(parts) if len(parts) > 1 else parts[0]
    task = known_task(settings, system, data)
    adaptive = _adaptive(task, settings)
    experiment = _experiment(settings, adaptive)
    folder = start_run(
        DESIGN, options, settings, system=options.system, data=fingerprint(data)
    )
    belief = believe_data(adaptive, system.swimmer, data, settings.position_noise)
    decision = decide(adaptive, belief)
    stage = Stage(adaptive, experiment, belief, decision.way)
    return folder, DesignResult(
        system=system.name,
        accuracy=settings.accuracy,
        course=Course.of(task),
        maps=map_belief(task, belief),
        decision=decision,
        thrust=adaptive.thrust,
        paths={
            "recorded": tuple(
                piece.states[piece.observed[:, :2].all(axis=1), :2] for piece in data
            )
        },
        next=suggest_next(stage, key=jax.random.key(settings.seed)),
    )


def _adaptive(task: Task, settings: DesignSettings) -> AdaptiveController:
    return AdaptiveController.of(
        observe_positions(task, settings.position_noise), MeanForce()
    )


def _experiment(settings: DesignSettings, adaptive: AdaptiveController) -> Experiment:
    """The recording of trajectories, and the region of release.

    Raises:
        InputError: the place of release is outside of the arena.
    """
    task, box = adaptive.task, settings.release_box()
    region = task.arena
    if box is not None:
        region = Rectangle(list(box[:2]), list(box[2:]))
        room = np.minimum(region.lower - task.arena.lower, 0) + np.minimum(
            task.arena.upper - region.upper, 0
        )
        if np.any(room < 0):
            raise InputError(
                f"--release: expected a rectangle inside of the arena, got "
                f"{settings.release}; state a larger one with --arena"
            )
    return record_positions(task, region, settings.duration)
