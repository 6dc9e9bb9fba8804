"""`pinav design`: what to record next, until a way is known."""

import itertools
from collections.abc import Mapping

import jax
import numpy as np
from tqdm import tqdm

from pinav.commands.command import CommandResult
from pinav.commands.data_file import read_data
from pinav.commands.design import DESIGN
from pinav.commands.design.metrics import (
    DesignMetrics,
    DesignRow,
    NextRow,
    relative_bound,
)
from pinav.commands.design.settings import DesignOptions, DesignSettings
from pinav.commands.recording_settings import RecordingSettings
from pinav.commands.start import fingerprint, start_run
from pinav.commands.steering import known_task, observe_positions, system_task
from pinav.errors import InputError
from pinav.navigation import Disc, Experiment, Rectangle, Task
from pinav.navigation.adaptive.steering import Adaptive
from pinav.navigation.adaptive.strategies import Certain
from pinav.navigation.belief.belief import Belief
from pinav.navigation.design.campaign import (
    Campaign,
    Decision,
    decide,
    record_positions,
    run_campaign,
)
from pinav.navigation.design.choices import (
    AbstractDesign,
    GridDesign,
    InformedDesign,
    RandomDesign,
    Stage,
    expected_sd,
)
from pinav.navigation.design.frames import believe_data
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

MAP_POINTS = 41
"""Points of the maps of the force along each side."""

Arrays = dict[str, np.ndarray]


def run(options: DesignOptions) -> CommandResult:
    """Design experiments as the command line does."""
    settings, system = options.settings, find_system(options.system)
    work = _suggest if options.data else _compare
    metrics, arrays, table, folder = work(options, settings, system)
    if table:
        folder.write_table("next.csv", ("t", "frequency", "heading"), table)
    folder.write_arrays("results.npz", arrays)
    folder.write_metrics("metrics.json", metrics)
    return CommandResult(metrics, metrics.text(), folder)


Finding = tuple[DesignMetrics, Arrays, list[tuple[float, ...]], RunFolder]


def _compare(
    options: DesignOptions, settings: DesignSettings, system: System
) -> Finding:
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
    rows = {name: DesignRow.of_campaigns(some) for name, some in campaigns.items()}
    metrics = DesignMetrics(system.name, settings.accuracy, rows)
    firsts = {name: some[0] for name, some in campaigns.items()}
    first = next(iter(firsts.values()))
    arrays = _map_arrays(adaptive, first.belief, first.decisions[-1])
    for name, some in campaigns.items():
        for index, path in enumerate(firsts[name].paths):
            arrays[f"path/{name}/{index}"] = path
        for index, one in enumerate(some):
            bounds = [relative_bound(decision) for decision in one.decisions]
            arrays[f"bound/{name}/{index}"] = np.array(bounds)
    return metrics, arrays, [], folder


def _suggest(
    options: DesignOptions, settings: DesignSettings, system: System
) -> Finding:
    """What recordings leave open, and what to record next."""
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
    key = jax.random.key(settings.seed)
    stage = Stage(adaptive, experiment, belief, decision.way)
    chosen = InformedDesign().choose(stage, key=key)
    after = expected_sd(stage, chosen)
    _, spread = belief.force(decision.way)
    x, y = np.asarray(chosen.starts[:2], float).tolist()
    possible = bool(np.isfinite(after))
    certain = decision.certain(settings.accuracy)
    row = NextRow(
        trajectories=len(data),
        arrives=decision.arrives,
        error=decision.error,
        certain=certain,
        sd=float(np.sqrt(np.mean(spread**2))),
        sd_after=after if possible else None,
        start=(x, y) if possible else None,
    )
    arrays = _map_arrays(adaptive, belief, decision)
    for index, piece in enumerate(data):
        seen = piece.observed[:, :2].all(axis=1)
        arrays[f"path/recorded/{index}"] = piece.states[seen, :2]
    table = []
    if possible:
        series = (experiment.knots, chosen.frequency, chosen.heading)
        table = list(zip(*(np.asarray(s).tolist() for s in series), strict=True))
    metrics = DesignMetrics(system.name, settings.accuracy, next=row)
    return metrics, arrays, table, folder


def _adaptive(task: Task, settings: DesignSettings) -> Adaptive:
    return Adaptive.of(observe_positions(task, settings.position_noise), Certain())


def _experiment(settings: DesignSettings, adaptive: Adaptive) -> Experiment:
    """How trajectories are recorded, and where they may be released.

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


def _map_arrays(adaptive: Adaptive, belief: Belief, decision: Decision) -> Arrays:
    """The learned force and the way, for the figures."""
    task, objective = adaptive.task, adaptive.replanner.objective
    lower, upper = np.asarray(task.arena.lower), np.asarray(task.arena.upper)
    x, y = np.linspace(lower, upper, MAP_POINTS).T
    points = np.stack(np.meshgrid(x, y), axis=-1)
    mean, sd = belief.force(points.reshape(-1, 2))
    discs = [[*z.center, z.radius] for z in task.keep_out if isinstance(z, Disc)]
    return {
        "arena": np.array([lower, upper]),
        "start": np.asarray(task.start[:2]),
        "goal": np.asarray(objective.goal),
        "tolerance": np.asarray(objective.tolerance),
        "discs": np.array(discs).reshape(-1, 3),
        "field/x": x,
        "field/y": y,
        "field/learned": mean.reshape(points.shape),
        "field/sd": sd.reshape(points.shape),
        "way": decision.way,
        "thrust": np.asarray(adaptive.thrust),
    }
