"""`pinav design`: what to record next, until a way is known."""

import itertools
from collections.abc import Callable, Mapping
from functools import partial

import jax
import numpy as np
from tqdm import tqdm

from pinav.commands import DESIGN
from pinav.commands.command import CommandResult
from pinav.commands.data_file import read_data
from pinav.commands.design import DesignOptions, DesignSettings
from pinav.commands.results import fingerprint, keep, start_run
from pinav.commands.steering import observe_positions, programme_table, system_task
from pinav.errors import InputError
from pinav.figures.images import Picture
from pinav.figures.navigation import bounds_figure, recordings_figure
from pinav.navigation import AdaptiveController, Course, Experiment, Rectangle, Task
from pinav.navigation.adaptive.flight import map_belief
from pinav.navigation.adaptive.strategies import MEAN_FORCE
from pinav.navigation.design.campaign import (
    Campaign,
    CampaignSummary,
    DesignResult,
    believe_data,
    decide,
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
from pinav.report import AbstractBlock, Cell, Paragraph, Section, Table
from pinav.scenarios import find_system
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
    parts = [read_data(path) for path in options.data]
    data = concatenate(parts) if len(parts) > 1 else next(iter(parts), None)
    task = system_task(settings, system, data)
    adaptive = AdaptiveController.of(
        observe_positions(task, settings.position_noise), MEAN_FORCE
    )
    experiment = _experiment(settings, adaptive.task)
    identity = {} if data is None else {"data": fingerprint(data)}
    folder = start_run(DESIGN, options, settings, system=options.system, **identity)
    result = partial(
        DesignResult,
        system=system.name,
        accuracy=settings.accuracy,
        course=Course.of(task),
        thrust=adaptive.thrust,
    )
    if data is None:
        return keep(DESIGN, folder, _compare(settings, adaptive, experiment, result))
    belief = believe_data(adaptive, system.swimmer, data, settings.position_noise)
    decision = decide(adaptive, belief)
    stage = Stage(adaptive, experiment, belief, decision.way)
    seen = (p.states[p.observed[:, :2].all(axis=1), :2] for p in data)
    found = result(
        maps=map_belief(task, belief),
        decision=decision,
        paths={"recorded": tuple(seen)},
        next=suggest_next(stage, key=jax.random.key(settings.seed)),
    )
    return keep(DESIGN, folder, found)


def _compare(
    settings: DesignSettings,
    adaptive: AdaptiveController,
    experiment: Experiment,
    result: Callable[..., DesignResult],
) -> DesignResult:
    """Simulated campaigns of each design, in pairs of the same noise."""
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
    return result(
        maps=map_belief(adaptive.task, first.belief),
        decision=first.decisions[-1],
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


def _experiment(settings: DesignSettings, task: Task) -> Experiment:
    """The recording of trajectories, and the region of release."""
    box = settings.release_box()
    if settings.duration < 2 * task.step:
        raise InputError(
            f"--duration: expected two steps or more, got {settings.duration:g} with "
            f"--step {task.step:g}"
        )
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
    return Experiment(task, region, settings.duration)


CAPTION = (
    "Finished: the force along the way was known well enough by the belief; "
    "trajectories: median until then, a dash where more than half were given up; until "
    "truly known: median until the true error was below the accuracy for the first "
    "time; right when finished: campaigns whose true error was then below it."
)


def sections(result: DesignResult) -> list[Section]:
    """The outcome, and what was recorded."""
    outcome: list[AbstractBlock] = [*map(Paragraph, sentences(result))]
    if result.designs:
        outcome += [design_table(result), _bounds(result)]
    if result.next is not None:
        caption = "Commands of the trajectory to record next; linear between the times."
        outcome.append(programme_table(result.next, caption, "next"))
    return [Section("Outcome", outcome), Section("Recordings", [_map(result)])]


def sentences(result: DesignResult) -> list[str]:
    """The findings in words."""
    if "recorded" in result.paths:
        return [_next_sentence(result)]
    lines = [
        f"System {result.system} (synthetic): trajectories until the force along the "
        f"planned way is known to {100 * result.accuracy:g} % with a probability of "
        "95 %, by the belief."
    ]
    informed = result.designs.get("informed")
    if informed is None or _known(informed.trajectories) is None:
        return lines
    for name, row in result.designs.items():
        if name == "informed" or not informed.trajectories:
            continue
        if _known(row.trajectories) is None:
            lines.append(f"Most {name} campaigns were given up.")
        else:
            ratio = informed.trajectories / row.trajectories
            lines.append(
                f"The informed design took {100 * ratio:.0f} % of the trajectories "
                f"of the {name} one (medians)."
            )
    return lines


def _known(value: float) -> float | None:
    """A number, or none where it is not finite."""
    return value if np.isfinite(value) else None


def design_table(result: DesignResult) -> Table:
    """One row for each design."""
    columns: dict[str, Callable[[tuple[str, CampaignSummary]], Cell]] = {
        "design": lambda one: one[0],
        "campaigns": lambda one: one[1].campaigns,
        "finished": lambda one: one[1].finished,
        "trajectories": lambda one: _known(one[1].trajectories),
        "fewest": lambda one: one[1].fewest,
        "largest": lambda one: one[1].largest,
        "until truly known": lambda one: _known(one[1].reached),
        "right when finished": lambda one: one[1].right,
        "true error at the end": lambda one: _known(one[1].error),
    }
    return Table.of(result.designs.items(), columns, CAPTION)


def _next_sentence(result: DesignResult) -> str:
    count, decision = len(result.paths["recorded"]), result.decision
    advice, accuracy = result.next, result.accuracy
    known = (
        f"After {count} trajectories the force along the planned way "
        f"is known to {100 * decision.error:.2g} % with a probability of 95 %"
    )
    if decision.certain(accuracy):
        return f"{known}; nothing further need be recorded for {100 * accuracy:g} %."
    if not decision.arrives:
        known = (
            f"After {count} trajectories no plan reaches the goal on the learned force"
        )
    if advice is None:
        return f"{known}; no candidate trajectory stays inside of the arena."
    x, y = advice.start
    return (
        f"{known}. Record next the trajectory in next.csv, released at ({x:.4g}, "
        f"{y:.4g}): the standard deviation of the force along the way, now "
        f"{advice.sd:.3g}, should then be {advice.sd_after:.3g}."
    )


def _bounds(result: DesignResult) -> Picture:
    return Picture(
        "design-bounds",
        partial(bounds_figure, result),
        "Bound of the relative error of the force along the planned way (95 %), after "
        "each trajectory of each campaign.",
        width=0.8,
    )


def _map(result: DesignResult) -> Picture:
    design = next((name for name, paths in result.paths.items() if paths), "")
    what = {"recorded": "the recordings", "": "no trajectory"}.get(
        design, f"the first campaign of the {design} design"
    )
    return Picture(
        "design-recordings",
        partial(recordings_figure, result, design),
        f"Standard deviation of the force after {what}, its trajectories, and the way "
        "that is planned then.",
        width=0.7,
    )
