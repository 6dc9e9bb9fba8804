"""What the explorer's page knows of a run, as JSON."""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np

from pinav.commands.explore.posterior import directions
from pinav.commands.explore.trees import Tree, leaf_table, pack_array, tree_of
from pinav.dynamics import AbstractDynamics, OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.evaluation import extent, square
from pinav.forces import ZeroForce, as_learned_force
from pinav.learning.learned import Learned
from pinav.scenarios import source_system
from pinav.systems import System
from pinav.trajectories import Trajectories, Trajectory

SAMPLES = 24_000
"""Samples of all tracks at most; longer tracks are thinned evenly."""

TRACKS = 200
"""Tracks at most; the longest ones."""

MODELS = 6
"""Models of a run at most."""


def payload_of(run: Learned, plan: Tree | None = None) -> Tree:
    """A run as the page takes it.

    Args:
        run: the fit.
        plan: of a navigation through the force that the fit has learned.

    Raises:
        InputError: the page cannot show the run.
    """
    data = run.data
    if data.dim != 2:
        raise InputError(
            f"{run.folder.path}: explore draws a plane, got the coordinates "
            f"{', '.join(data.channels)}; take pinav report"
        )
    box, times = square(data), _times(data)
    if plan is not None:
        box = _union(box, plan["arena"])
    names = _shown_models(run)
    first = run.models[names[0]]
    return {
        "version": 1,
        "title": _title(run, first),
        "run": run.folder.path.name,
        "order": _order(first, run.system),
        "units": {**data.units, "force": run.system.base_units.force},
        "box": list(map(float, box)),
        "extent": float(extent(data)),
        "clock": times,
        "noise": float(run.noise),
        "kicks": _kicks(run),
        "models": [{"name": n, "tree": tree_of(run.models[n])} for n in names],
        "physics": tree_of(_without_environment(first, run.system)),
        "truth": _truth(run),
        "posterior": _posterior(run, box, times),
        "tracks": _tracks(run),
        "plan": plan,
    }


def _title(run: Learned, model: AbstractDynamics) -> str:
    """System and model; the system alone where nothing stands for an environment."""
    name = run.system.name
    if isinstance(getattr(model, "environment", None), ZeroForce):
        return name
    return f"{name}: {run.choice.name}"


def _union(
    box: tuple[float, float, float, float], arena: list[list[float]]
) -> tuple[float, float, float, float]:
    """The smallest square around a box and an arena, which shares their middle."""
    low = np.minimum(box[::2], arena[0])
    high = np.maximum(box[1::2], arena[1])
    middle, half = (low + high) / 2, float((high - low).max()) / 2
    x, y = middle.tolist()
    return x - half, x + half, y - half, y + half


def _shown_models(run: Learned) -> list[str]:
    """Names of the models, those that hold the known physics first."""
    swims = Swimmer | OverdampedSwimmer
    order = sorted(run.models, key=lambda n: not isinstance(run.models[n], swims))
    return order[:MODELS]


def _order(model: AbstractDynamics, system: System) -> int:
    return 1 if isinstance(model, OverdampedSwimmer) else system.order


def _times(data: Trajectories) -> tuple[float, float]:
    """First and last time of the data [T]."""
    times = data.times[data.observed.any(axis=-1)]
    return float(times.min()), float(times.max())


def _kicks(run: Learned) -> float:
    r"""Strength of the noise that moves the swimmer, $\sqrt{2D}$ [L T^(-1/2)].

    That of a velocity that wanders is taken for white, which it is over times long
    against its memory.
    """
    if run.evidence is not None and "diffusion" in run.evidence.constants:
        return math.sqrt(2 * max(run.evidence.constants["diffusion"].value, 0.0))
    if run.system.diffusion is not None:
        return math.sqrt(2 * run.system.diffusion)
    wandering = run.system.wandering
    if wandering is None:
        return 0.0
    strength = float(wandering.strength(jnp.asarray(1.0)))
    return strength * math.sqrt(2 * wandering.memory)


def _without_environment(model: AbstractDynamics, system: System) -> AbstractDynamics:
    swims = isinstance(model, Swimmer | OverdampedSwimmer)
    return (model if swims else system.swimmer).without_environment()


def _truth(run: Learned) -> Tree | None:
    """The true swimmer, where the system or the data state it and the page knows it."""
    source = source_system(run.data.provenance)
    for system in (run.system, source):
        if system is not None and system.environment is not None:
            try:
                return tree_of(system.true_swimmer)
            except InputError:
                return None
    return None


def _posterior(
    run: Learned, box: tuple[float, float, float, float], times: tuple[float, float]
) -> Tree | None:
    """The posterior by its leading directions; none where nothing is learned."""
    posterior = run.posterior
    if posterior is None or "model" not in run.models or not len(posterior.mean):
        return None
    environment: Any = getattr(run.models["model"], "environment", None)
    learned = as_learned_force(environment)
    static = learned is None or learned.is_static
    moments = times[:1] if static else tuple(np.linspace(*times, 5).tolist())
    factor, kept = directions(posterior, box, moments)
    leaves = leaf_table(posterior.free.unravel(jnp.asarray(posterior.mean)))
    return {
        "leaves": leaves,
        "mean": pack_array(posterior.mean, "f8"),
        "factor": pack_array(factor),
        "kept": kept,
    }


def _tracks(run: Learned) -> list[Tree]:
    """The tracks, longest ones where there are many, thinned where they are long."""
    data = run.data
    order = sorted(range(len(data)), key=lambda i: -int(data.lengths[i]))[:TRACKS]
    total = sum(int(data.lengths[i]) for i in order)
    every = max(math.ceil(total / SAMPLES), 1)
    pieces = list(data)
    return [_track(run, i, pieces[i], every) for i in sorted(order)]


def _track(run: Learned, index: int, piece: Trajectory, every: int) -> Tree:
    is_observed = piece.observed[:, : run.data.dim].all(axis=1)
    shown = np.flatnonzero(is_observed)[::every]
    start = run.start(index)
    if run.evidence is None and not piece.observed[0].all():
        start = np.where(piece.observed[0], piece.states[0], 0.0)
    track = {
        "index": index,
        "start": np.asarray(start, float).tolist(),
        "from": float(piece.times[0]),
        "to": float(piece.times[-1]),
        "times": pack_array(piece.times[shown]),
        "x": pack_array(piece.states[shown, 0]),
        "y": pack_array(piece.states[shown, 1]),
    }
    if {"frequency", "heading"} <= piece.commands.keys():
        track["commands"] = _commands(piece)
    return track


def _commands(piece: Trajectory) -> Tree:
    """Commands where they change, which says all of what is held in between."""
    values = np.stack([piece.commands["frequency"], piece.commands["heading"]])
    changed = np.any(values[:, 1:] != values[:, :-1], axis=0)
    kept = np.concatenate([[0], np.flatnonzero(changed) + 1])
    if len(kept) > SAMPLES // 4:
        kept = kept[:: math.ceil(len(kept) / (SAMPLES // 4))]
    return {
        "kind": "HeldProgramme",
        "times": pack_array(piece.times[kept], "f8"),
        "frequency": pack_array(values[0, kept]),
        "heading": pack_array(values[1, kept]),
    }
