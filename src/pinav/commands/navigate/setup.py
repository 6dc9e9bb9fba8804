"""What `pinav navigate` works with: a task, and models of its time_cost."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pinav.actuation import LinearResponse
from pinav.commands.fitted_run import MODEL_FILE, FittedRun
from pinav.commands.navigate.settings import NavigateSettings
from pinav.dynamics import OverdampedSwimmer, Swimmer
from pinav.errors import InputError
from pinav.evaluation import square
from pinav.fitting import Posterior
from pinav.fitting.environments.catalogue import KnownSwimmer
from pinav.forces import UniformFlow, ZeroForce
from pinav.identification.models import response_of
from pinav.navigation.control.simple import physics_only
from pinav.navigation.task.objectives import ReachGoal
from pinav.navigation.task.steering import (
    CommandLimits,
    RollingActuator,
    SteeredSwimmer,
)
from pinav.navigation.task.task import Task
from pinav.navigation.task.zones import Disc, Rectangle
from pinav.runs import RunFolder
from pinav.scenarios import source_system
from pinav.trajectories import Trajectories


class Fitted(eqx.Module):
    """A fit with a posterior.

    Attributes:
        posterior: of the model.
        noise: standard deviation of what was observed.
        states: smoothed states of the data.
        data: what was fitted.
    """

    posterior: Posterior
    noise: float
    states: np.ndarray
    data: Trajectories


class NavigationProblem(eqx.Module):
    """A task and what is known of it.

    Attributes:
        task: its truth is that of the scenario, or the model where there is none.
        model: the fitted swimmer.
        samples: of the posterior; none where the run has no posterior.
        truth: the name of the scenario that is the truth, where there is one.
        fitted: the fit, where it has a posterior.
        goal: the middle of the goal, and its radius.
        discs: that must not be entered.
        data: what was fitted, where it holds positions of trajectories.
        units: of positions and times.
    """

    task: Task
    model: SteeredSwimmer
    samples: tuple[SteeredSwimmer, ...]
    truth: str | None
    fitted: Fitted | None
    goal: ReachGoal
    discs: tuple[Disc, ...]
    data: Trajectories | None
    units: dict[str, str]

    @property
    def physics(self) -> SteeredSwimmer:
        """The fitted swimmer without its environment."""
        return physics_only(self.model)

    @property
    def truths(self) -> tuple[SteeredSwimmer, ...]:
        """Swimmers in which controllers are tried."""
        if self.truth is None and self.samples:
            return self.samples
        return (self.task.truth,)


def navigation_problem(settings: NavigateSettings, run: RunFolder) -> NavigationProblem:
    """The problem of a run.

    Raises:
        InputError: the run holds no fitted swimmer in the plane.
    """
    if run.has(MODEL_FILE):
        return _of_fit(settings, run)
    if run.has("metrics.json") and "tracks" in run.read_json("metrics.json"):
        return _of_recording(settings, run)
    raise InputError(
        f"{run.path} holds no finished fit; give the folder that was the --out of "
        "pinav fit"
    )


def _of_fit(settings, run: RunFolder) -> NavigationProblem:
    fitted = FittedRun.open(run.path)
    model, data = fitted.model, fitted.data
    if not isinstance(model, KnownSwimmer) or not _is_planar(model, data):
        raise InputError(
            f"{run.path}: expected a swimmer in the plane with a learned force, got "
            f"the model {fitted.choice.name} of {', '.join(data.channels)}"
        )
    actuator = RollingActuator(settings.thrust * jnp.eye(2), LinearResponse())
    evidence = fitted.evidence
    found = None
    if evidence is not None:
        found = Fitted(evidence.posterior, fitted.noise, evidence.states, data)
    source = source_system(data.provenance)
    known_truth = source is not None and source.environment is not None
    known = source.true_swimmer if source is not None and known_truth else model
    limits = CommandLimits(1.0)
    return NavigationProblem(
        task=_task(settings, SteeredSwimmer(known, actuator), limits, data),
        model=SteeredSwimmer(model, actuator),
        samples=tuple(SteeredSwimmer(one, actuator) for one in _draws(found, settings)),
        truth=source.name if source is not None and known_truth else None,
        fitted=found,
        goal=_goal(settings),
        discs=_discs(settings),
        data=data,
        units=data.units,
    )


def _draws(found: Fitted | None, settings: NavigateSettings) -> list[Any]:
    if found is None or settings.samples == 0:
        return []
    key = jax.random.fold_in(jax.random.key(settings.seed), 1)
    return found.posterior.samples(settings.samples, key=key)


def _is_planar(model: KnownSwimmer, data: Trajectories) -> bool:
    states = 4 if isinstance(model, Swimmer) else 2
    return data.channels[:2] == ("x", "y") and len(data.channels) in (2, states)


def _of_recording(settings: NavigateSettings, run: RunFolder) -> NavigationProblem:
    metrics = run.read_json("metrics.json")
    tracks = {k: v for k, v in metrics["tracks"].items() if v.get("gain")}
    if not tracks:
        raise InputError(
            f"{run.path}: no track has a fitted propulsion; navigation needs commands "
            "in the recording, and a fit of this version of pinav"
        )
    name = max(tracks, key=lambda key: tracks[key]["duration"])
    track = tracks[name]
    found = {key: pair["value"] for key, pair in track["estimates"].items()}
    corner = np.log(found["corner"]) if "corner" in found else 0.0
    residual = _logit(found["residual"]) if "residual" in found else 0.0
    response = response_of(track["response"], corner, residual)
    actuator = RollingActuator(jnp.asarray(track["gain"]), response)
    drift = jnp.asarray([found.get("drift x", 0.0), found.get("drift y", 0.0)])
    robot = OverdampedSwimmer(ZeroForce(), ZeroForce(), 1.0, UniformFlow(drift))
    swimmer = SteeredSwimmer(robot, actuator)
    limits = CommandLimits(settings.frequency)
    return NavigationProblem(
        task=_task(settings, swimmer, limits, None),
        model=swimmer,
        samples=(),
        truth=None,
        fitted=None,
        goal=_goal(settings),
        discs=_discs(settings),
        data=None,
        units=metrics["units"],
    )


def _logit(share: float) -> float:
    return float(np.log(share / (1 - share)))


def _goal(settings: NavigateSettings) -> ReachGoal:
    return ReachGoal(list(settings.places()[1]), settings.tolerance)


def _discs(settings: NavigateSettings) -> tuple[Disc, ...]:
    return tuple(Disc(list(disc[:2]), disc[2]) for disc in settings.discs())


def _task(
    settings: NavigateSettings,
    truth: SteeredSwimmer,
    limits: CommandLimits,
    data: Trajectories | None,
) -> Task:
    start, _ = settings.places()
    rest = (0.0, 0.0) if isinstance(truth.dynamics, Swimmer) else ()
    return Task(
        name="navigate",
        truth=truth,
        start=jnp.asarray([*start, *rest]),
        objective=_goal(settings),
        limits=limits,
        arena=_arena(settings, data),
        keep_out=_discs(settings),
        step=settings.step,
        time_limit=settings.time_limit,
        noise=settings.noise,
        sensor_noise=settings.sensor_noise,
        delay=settings.delay,
    )


def _arena(settings: NavigateSettings, data: Trajectories | None) -> Rectangle:
    """The arena that was given, or one around data, start and goal."""
    box = settings.box()
    if box is not None:
        return Rectangle(list(box[:2]), list(box[2:]))
    ends = np.array(settings.places())
    margin = 0.25 * float(np.linalg.norm(ends[1] - ends[0])) + settings.tolerance
    corners = [ends.min(axis=0) - margin, ends.max(axis=0) + margin]
    if data is not None:
        x_from, x_to, y_from, y_to = square(data)
        corners[0] = np.minimum(corners[0], [x_from, y_from])
        corners[1] = np.maximum(corners[1], [x_to, y_to])
    return Rectangle(*corners)
