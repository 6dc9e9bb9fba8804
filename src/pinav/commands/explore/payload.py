"""What the explorer's page knows of a run, as JSON."""

import math
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.commands.explore.printing import Tree, pack_array
from pinav.commands.explore.programs import Controls, Programs, TableBox
from pinav.dynamics import (
    AbstractDynamics,
    AbstractSwimmer,
    OverdampedSwimmer,
    Swimmer,
    takes_commands,
)
from pinav.dynamics.swimmers import unbound
from pinav.errors import InputError
from pinav.evaluation import extent, square
from pinav.fitting import Posterior
from pinav.forces import ZeroForce, as_learned_force
from pinav.learning.learned import Learned
from pinav.navigation import AbstractNavigation, Navigation
from pinav.runs import RunFolder
from pinav.scenarios import source_system
from pinav.trajectories import Trajectory

SAMPLES = 24_000
"""Samples of all tracks at most; longer tracks are thinned evenly."""

TRACKS = 200
"""Tracks at most; the longest ones."""

MODELS = 6
"""Models of a run at most."""


def payload_of(run: Learned, plan: Tree | None = None) -> Tree:
    """A run as the page takes it.

    Args:
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
    sampled = data.times[data.observed.any(axis=-1)]
    box, times = square(data), (float(sampled.min()), float(sampled.max()))
    if plan is not None:
        box = _union(box, plan["arena"])
    order = sorted(
        run.models, key=lambda name: not isinstance(run.models[name], AbstractSwimmer)
    )
    names = order[:MODELS]
    first = run.models[names[0]]
    # a network that is the whole rate of change has a force, and no thrust of its own
    known = first if isinstance(first, AbstractSwimmer) else None
    has_force = known is None or not isinstance(known.environment, ZeroForce)
    has_thrust = known is not None and not isinstance(known.propulsion, ZeroForce)
    most = max((len(_changes(piece)) for piece in data), default=1) or 1
    controls = Controls(most if takes_commands(first) else None)
    programs = Programs(controls, TableBox((box[0], box[2]), (box[1], box[3]), times))
    models = [
        programs.add(run.models[n], run.posterior if n == "model" else None)
        for n in names
    ]
    truth = _true_swimmer(run)
    physics = programs.add((known or run.system.swimmer).without_environment())
    if plan is not None:
        plan = {**plan, "steered": programs.add_steered(first)}
    tracks = _tracks(run)
    return {
        "version": 2,
        "title": run.system.name + (f": {run.choice.name}" if has_force else ""),
        "run": run.folder.path.name,
        "order": 1 if isinstance(first, OverdampedSwimmer) else run.system.order,
        "units": {**data.units, "force": run.system.base_units.force},
        "box": list(map(float, box)),
        "extent": float(extent(data)),
        "clock": times,
        "noise": float(run.noise),
        "kicks": _kicks(run),
        "models": [
            {"name": n, **model} for n, model in zip(names, models, strict=True)
        ],
        "physics": physics,
        "truth": None if truth is None else programs.add(truth),
        "posterior": _posterior(run, box, times) if models[0]["parameters"] else None,
        "hasForce": has_force,
        "hasThrust": has_thrust,
        "commands": controls.count,
        "response": _response(first, tracks),
        "tracks": tracks,
        "plan": plan,
        "programs": programs.text,
    }


def _union(
    box: tuple[float, float, float, float], arena: list[list[float]]
) -> tuple[float, float, float, float]:
    """The smallest square around a box and an arena, which shares their middle."""
    low = np.minimum(box[::2], arena[0])
    high = np.maximum(box[1::2], arena[1])
    middle, half = (low + high) / 2, float((high - low).max()) / 2
    x, y = middle.tolist()
    return x - half, x + half, y - half, y + half


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


def _true_swimmer(run: Learned) -> Swimmer | OverdampedSwimmer | None:
    """The true swimmer, where the system or the data state it."""
    source = source_system(run.data.provenance)
    for system in (run.system, source):
        if system is not None and system.environment is not None:
            return system.true_swimmer
    return None


def _response(model: AbstractDynamics, tracks: list[Tree]) -> Tree | None:
    """Speed over commanded frequency of a propulsion that takes commands."""
    if not takes_commands(model):
        return None
    propulsion = unbound(model)
    greatest = max((track.get("fastest", 0.0) for track in tracks), default=0.0)
    frequencies = np.linspace(0.0, 1.5 * max(greatest, 2.0), 81)

    def velocity(frequency: Array, heading: float) -> Array:
        held = {"frequency": frequency[None], "heading": jnp.array([heading])}
        force = propulsion.drive_by(jnp.zeros(1), held)
        a, b = force(0.0, jnp.zeros(2), jnp.zeros(2))
        return a + 1j * b

    def speed(frequency: Array) -> Array:
        """That of the gain without its turn: coils are unequal."""
        ahead, aside = velocity(frequency, 0.0), velocity(frequency, math.pi / 2)
        return jnp.abs(ahead - 1j * aside) / 2

    response = getattr(propulsion, "response", propulsion)
    corner = getattr(response, "corner", None)
    return {
        "name": type(response).__name__.removesuffix("Response").lower(),
        "frequencies": pack_array(frequencies, "f8"),
        "speeds": pack_array(
            np.asarray(jax.vmap(speed)(jnp.asarray(frequencies))), "f8"
        ),
        "corner": None if corner is None else float(corner),
    }


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
    return {
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
        kept = _changes(piece)
        frequency = piece.commands["frequency"]
        track["fastest"] = float(np.max(frequency))
        track["commands"] = {
            "times": pack_array(piece.times[kept], "f8"),
            "frequency": pack_array(frequency[kept]),
            "heading": pack_array(piece.commands["heading"][kept]),
        }
    return track


def _changes(piece: Trajectory) -> np.ndarray:
    """Samples at which a command changes, which say all of what is held in between."""
    if not {"frequency", "heading"} <= piece.commands.keys():
        return np.zeros(0, int)
    values = np.stack([piece.commands["frequency"], piece.commands["heading"]])
    changed = np.any(values[:, 1:] != values[:, :-1], axis=0)
    kept = np.concatenate([[0], np.flatnonzero(changed) + 1])
    return kept[:: math.ceil(len(kept) / (SAMPLES // 4))]


NUMBERS = 130_000
"""Numbers of the factor at most: 0.7 MB of a page of at most 1.5 MB."""

FEW = 64
"""Directions that are all kept, without asking which of them matter."""

NEGLIGIBLE = 1e-7
"""Share of the variance below which a direction is left out."""

GRID = 25
"""Points along each side on which directions are weighed."""


def directions(
    posterior: Posterior,
    box: tuple[float, float, float, float],
    times: tuple[float, ...] = (0.0,),
) -> tuple[Float[np.ndarray, "parameter direction"], float]:
    r"""A factor $L$ of the covariance, $\Sigma \approx L L^\top$, and what it keeps.

    Most of the variance of weights has no effect. Kept are the directions that matter
    most for the force on a grid, the leading right singular vectors of
    $D^{-1} J \Sigma^{1/2}$ with the Jacobian $J$ of the force. $D$ holds the standard
    deviations of the force, so that places where it is well known count as much as
    those where it is not; each constant that does not enter the force counts as one
    place.

    Args:
        box: where the force is weighed, x from and to, y from and to [L].
        times: at which it is weighed [T].

    Returns:
        The factor, with at most `NUMBERS` numbers, and the share of the relative
        variance on the grid that it keeps.
    """
    values, vectors = np.linalg.eigh(posterior.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    if len(root) <= FEW:
        return root, 1.0
    x, y = np.linspace(*box[:2], GRID), np.linspace(*box[2:], GRID)
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    rows = np.concatenate(
        [posterior.force_jacobians(points, t).reshape(-1, len(root)) for t in times]
    )
    silent = np.abs(rows).max(axis=0) == 0
    relative = np.concatenate([rows @ root, root[silent]])
    spread = np.linalg.norm(relative, axis=1, keepdims=True)
    relative = relative / np.where(spread > 0, spread, 1.0)
    variances, right = np.linalg.eigh(relative.T @ relative)
    variances, right = np.maximum(variances[::-1], 0.0), right[:, ::-1]
    matter = int(np.sum(variances > NEGLIGIBLE * variances.sum()))
    keep = min(max(NUMBERS // len(root), 1), matter)
    kept = float(variances[:keep].sum() / variances.sum())
    return root @ right[:, :keep], kept


RESULT = "metrics"
"""Files of the result of a navigation, without ending."""

LEVELS = 65535
"""Steps of a value of the plan."""


def fit_of_plan(folder: RunFolder, stated: Path | None) -> Path:
    """The run of the model that a plan was made with.

    Args:
        stated: where that run is; the one of its name beside the plan unless given.

    Raises:
        InputError: it is not there.
    """
    name = folder.identity().get("fitted", "")
    beside = folder.path.resolve().parent / name
    fit = beside if stated is None else stated
    if not RunFolder(fit).exists():
        raise InputError(
            f"{folder.path}: expected the run {name!r} that it was planned with beside "
            "it; name that folder with --fit"
        )
    return fit


def plan_of(folder: RunFolder) -> Tree:
    """The plan of a run as the page takes it.

    Raises:
        InputError: the run has none, such as one in space.
    """
    result: AbstractNavigation = folder.load(RESULT, AbstractNavigation)
    if not isinstance(result, Navigation) or result.plan.lattice is None:
        raise InputError(
            f"{folder.path}: its results hold no plan that can be evaluated; expected "
            "one in the plane, of a learned model"
        )
    course, lattice = result.course, result.plan.lattice
    plan: Tree = {
        "arena": course.arena.tolist(),
        "start": course.start.tolist(),
        "goal": course.goal.tolist(),
        "tolerance": course.tolerance,
        "discs": course.discs.tolist(),
        "step": result.step,
        "lower": lattice.lower.tolist(),
        "spacing": lattice.spacing.tolist(),
        "scale": lattice.scale,
        "ahead": lattice.ahead,
        "horizon": lattice.horizon,
        "thrusts": lattice.thrusts.tolist(),
    }
    # Between zero and one: sixteen bits are finer than the lattice is right.
    levels = np.round(np.clip(lattice.values, 0.0, 1.0) * LEVELS)
    plan["values"] = pack_array(levels, "u2")
    if result.suggestion is not None and result.suggestion.path is not None:
        plan["suggestion"] = result.suggestion.path.tolist()
    return plan
