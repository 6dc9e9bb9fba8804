"""All controllers on one task, over draws of the data and of the noise."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np

from benchmarks.navigate.gaussian_process import gaussian_process
from benchmarks.navigate.line_of_sight import LineOfSight
from pinav.codec import encode
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.learning.learn import learn
from pinav.learning.learned import Learned
from pinav.learning.recipes import ModelName
from pinav.navigation.control.controller import AbstractController, StraightLine
from pinav.navigation.control.default import controller
from pinav.navigation.task.catalogue import TASKS, task, training
from pinav.navigation.task.steering import SteeredSwimmer, physics_only
from pinav.navigation.task.task import FollowPath, Task, steered_swimmer
from pinav.navigation.trials.closed_loop import (
    Episodes,
    concatenate_episodes,
    run,
    run_many,
)
from pinav.navigation.trials.metrics import Interval, proportion, regret, summary
from pinav.runs import RunFolder

MODELS: dict[str, ModelName] = {
    "moving-barrier": "kernel-potential-time",
    "shear-current": "kernel-mixture",
    "channel-current": "kernel-mixture",
    "vortex-current": "kernel-mixture",
    "drift-current": "kernel-mixture",
}
"""What stands for the unknown of a scenario: `kernel-potential` unless named here."""


class Contest(eqx.Module):
    """How much is tried.

    Attributes:
        fits: draws of the training data.
        seeds: runs with the model of each.
        samples: models drawn from each posterior.
    """

    fits: int
    seeds: int
    samples: int


class Knowledge(eqx.Module):
    """What was learned from one draw of the training data.

    Attributes:
        model: the fit.
        samples: of its posterior.
        gaussian_process: the published baseline, from the same data.
    """

    model: SteeredSwimmer
    samples: tuple[SteeredSwimmer, ...]
    gaussian_process: SteeredSwimmer


def learned(name: str, draw: int, samples: int, folder: RunFolder) -> Knowledge:
    """Fit a task's time_cost; a fit that the folder holds is read."""
    source = TASKS[name][1]
    data = training(name, jax.random.key(1000 + draw))
    path = folder.path / "fits" / f"{source}-{draw}"
    chosen = MODELS.get(source, "kernel-potential")
    if not (path / "metrics.json").exists():
        learn(None, data, model=chosen).save(path, overwrite=True)
    fitted = Learned.open(path)
    model: Any = fitted.model
    drawn: list[Any] = []
    if samples and fitted.posterior is not None:
        drawn = fitted.posterior.samples(samples, key=jax.random.key(draw))
    assert isinstance(model, Swimmer | OverdampedSwimmer)
    known = task(name).truth.dynamics
    assert isinstance(known, Swimmer | OverdampedSwimmer)
    baseline = gaussian_process(known, data)
    own = task(name)
    return Knowledge(
        steered_swimmer(own, model),
        tuple(steered_swimmer(own, one) for one in drawn),
        steered_swimmer(own, baseline),
    )


Maker = Callable[[Task, Knowledge], AbstractController]

CONTROLLERS: dict[str, Maker] = {
    "oracle": lambda own, _: controller(own, own.truth),
    "learned": lambda own, known: controller(own, known.model, samples=known.samples),
    "physics only": lambda own, _: controller(own, physics_only(own.truth)),
    "straight line": lambda own, _: StraightLine(own.objective, own.limits),
    "line of sight": lambda own, known: LineOfSight.of(own, known.model),
    "Gaussian process": lambda own, known: controller(own, known.gaussian_process),
}
"""What steers; each takes what it may know of the second argument."""

WITHOUT_DATA = ("oracle", "physics only", "straight line")
"""Controllers that do not depend on the draw of the data."""


def contest(name: str, design: Contest, folder: RunFolder) -> dict[str, Any]:
    """Results of all controllers on a task; those of the folder are read."""
    file = f"task-{name}.json"
    if folder.has(file):
        folder.manifest.check(file)
        return folder.read_json(file)
    own = task(name)
    draws = [learned(name, d, design.samples, folder) for d in range(design.fits)]
    result: dict[str, Any] = {"controllers": {}, "regret": {}, "refused": {}}
    oracle = None
    for title, make in CONTROLLERS.items():
        try:
            episodes = _episodes(own, make, draws, design, once=title in WITHOUT_DATA)
        except InputError as error:
            result["refused"][title] = str(error)
            continue
        oracle = episodes if title == "oracle" else oracle
        result["controllers"][title] = _row(own, episodes)
        if title != "oracle" and oracle is not None and oracle.reached.any():
            result["regret"][title] = _interval(regret(episodes, oracle))
    steering = CONTROLLERS["learned"](own, draws[0])
    compute = run(own, steering, key=jax.random.key(0)).compute
    result["step"] = {
        "first": float(compute[0]),
        "median": float(np.median(compute[1:])),
    }
    folder.write_json(file, result)
    return folder.read_json(file)


def _episodes(
    own: Task, make: Maker, draws: list[Knowledge], design: Contest, *, once: bool
) -> Episodes:
    """Runs over all draws; the keys of a draw are the same for every controller."""
    keys = jax.random.split(jax.random.key(7), design.fits * design.seeds)
    if once:
        return run_many(own, make(own, draws[0]), keys)
    fractions = np.split(np.arange(len(keys)), design.fits)
    return concatenate_episodes(
        [
            run_many(own, make(own, known), keys[fraction])
            for known, fraction in zip(draws, fractions, strict=True)
        ]
    )


def _row(own: Task, episodes: Episodes) -> dict[str, Any]:
    """Metrics of a controller, as JSON."""
    found = summary(episodes, own)
    row = encode(found).document
    if not isinstance(own.objective, FollowPath):
        lost = len(episodes.steps) - int(episodes.reached.sum())
        row["failed"] = _interval(proportion(lost, len(episodes.steps)))
    return row


def _interval(interval: Interval) -> dict[str, Any]:
    """An interval, as JSON."""
    return encode(interval).document
