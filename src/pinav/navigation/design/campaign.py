"""Record, learn, and choose what to record next, until the force along a way is known.

A campaign is a sequence of trajectories. After each one the belief of
`pinav.navigation.belief` is brought up to date, the way is planned anew on its mean,
and the campaign ends when the force along that way is known well enough.
"""

import dataclasses
import math
from collections.abc import Iterator, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from pinav.dynamics import AbstractSwimmer, drive_by_arrays
from pinav.errors import InputError
from pinav.learning.findings import ForceMaps
from pinav.navigation.adaptive.flight import true_force
from pinav.navigation.adaptive.steering import TO_THE_END, AdaptiveController
from pinav.navigation.adaptive.strategies import MEAN_FORCE, with_known
from pinav.navigation.belief.belief import Belief, Frame
from pinav.navigation.design import candidates
from pinav.navigation.task.task import Course, ReachGoal
from pinav.navigation.trials.metrics import quantiles
from pinav.navigation.trials.situation import advance_compiled, begin, mean_thrust
from pinav.trajectories import Trajectories, Trajectory

DRAWS = 100
"""Draws of the force whose errors decide whether a way is known."""

CONFIDENCE = 0.95
"""Probability that the error is below the accuracy when a campaign ends."""

WAY_POINTS = 40
"""Points of a way at which the force is asked for."""

Way = Float[np.ndarray, "point 2"]


@dataclasses.dataclass(frozen=True, eq=False)
class Decision:
    """Knowledge of the way after some trajectories.

    Attributes:
        way: the planned one [L]; the straight line where no plan arrives.
        error: bound of the relative error of the force along the way, which holds with
            a probability of 95 %.
        true_error: the relative error itself, where the truth is known.
    """

    way: Way
    arrives: bool
    error: float
    true_error: float | None = None

    def certain(self, accuracy: float) -> bool:
        """True where nothing further need be recorded."""
        return self.arrives and self.error <= accuracy


@dataclasses.dataclass(frozen=True, eq=False)
class Campaign:
    """Recorded trajectories, and the knowledge after each of them.

    Attributes:
        paths: true positions of each trajectory [L].
        decisions: before the first trajectory and after each.
    """

    accuracy: float
    paths: tuple[Float[np.ndarray, "time 2"], ...]
    decisions: tuple[Decision, ...]
    belief: Belief

    @property
    def finished(self) -> bool:
        """True where the way is known well enough, by the belief."""
        return self.decisions[-1].certain(self.accuracy)

    @property
    def right(self) -> bool | None:
        """True where the true error is then small enough; none if not finished."""
        error = self.decisions[-1].true_error
        if not self.finished or error is None:
            return None
        return error <= self.accuracy


def run_campaign(
    adaptive: AdaptiveController,
    design: candidates.AbstractDesign,
    experiment: candidates.Experiment,
    *,
    accuracy: float,
    most: int,
    key: PRNGKeyArray,
) -> Campaign:
    """A campaign in the task's true environment.

    Args:
        accuracy: relative error of the force along the way that is small enough.
        most: trajectories after which the campaign is given up.

    Raises:
        InputError: `accuracy` is not between 0 and 1, or `most` is below 1.
    """
    if not 0 < accuracy < 1:
        raise InputError(f"accuracy: expected between 0 and 1, got {accuracy}")
    if most < 1:
        raise InputError(f"most: expected 1 or more, got {most}")
    belief = adaptive.believe(adaptive.first_frame)
    decisions, paths = [decide(adaptive, belief)], []
    for count in range(most):
        choose, noise = jax.random.split(jax.random.fold_in(key, count))
        way = decisions[-1].way
        stage = candidates.Stage(adaptive, experiment, belief, way, count)
        chosen = design.choose(stage, key=choose)
        frames, path = record(experiment, chosen, key=noise)
        belief = learn(adaptive, belief, frames)
        paths.append(path)
        decisions.append(decide(adaptive, belief))
        if decisions[-1].certain(accuracy):
            break
    return Campaign(accuracy, tuple(paths), tuple(decisions), belief)


def record(
    experiment: candidates.Experiment,
    candidate: candidates.CandidateTrajectories,
    *,
    key: PRNGKeyArray,
) -> tuple[list[Frame], Float[np.ndarray, "time 2"]]:
    """A trajectory of the true swimmer, until it leaves the arena.

    Returns:
        Its frames, and the true positions then [L].
    """
    task = experiment.task
    assert isinstance(task.objective, ReachGoal)
    endless = dataclasses.replace(
        task,
        start=candidate.starts,
        objective=ReachGoal(task.objective.goal, 1e-9),
        time_limit=experiment.duration,
    )
    now, sd = begin(endless), task.position_sd
    moments = np.arange(round(experiment.duration / task.step)) * task.step
    commands = experiment.commands(candidate, moments)
    states, thrusts = [now.state], [np.zeros(2)]
    for k, command in enumerate(commands):
        before = now.pending
        now, allowed = advance_compiled(
            endless, endless.truth, now, command, jax.random.fold_in(key, k)
        )
        if bool(now.violated):
            break
        states.append(now.state)
        thrusts.append(mean_thrust(task, jnp.concatenate([before, allowed[None]])))
    path = np.asarray(jnp.stack(states), float)[:, :2]
    seed = np.asarray(jax.random.key_data(key)).tolist()
    seen = path + sd * np.random.default_rng(seed).standard_normal(path.shape)
    frames = [
        Frame(k * task.step, seen[k], sd, thrust) for k, thrust in enumerate(thrusts)
    ]
    return frames, path


def learn(
    adaptive: AdaptiveController,
    belief: Belief,
    frames: Sequence[Frame],
    speed_sd: float | None = None,
) -> Belief:
    """The belief after a further trajectory.

    Args:
        speed_sd: standard deviation of each component of the first velocity; at rest
            unless given.
    """
    speed_sd = adaptive.rest_sd(frames[0]) if speed_sd is None else speed_sd
    belief = belief.restart(frames[0], speed_sd=speed_sd)
    for frame in frames[1:]:
        belief = belief.after(with_known(frame, belief, adaptive.physics))
    return belief


def decide(adaptive: AdaptiveController, belief: Belief) -> Decision:
    r"""Plan the way on the mean force, and say how well the force along it is known.

    The error of a draw F of the belief is $|F - \bar F| / |F|$, root sums of squares
    over the way; the bound is its quantile of 95 %.
    """
    task = adaptive.task
    tables = MEAN_FORCE.tables(belief, adaptive.physics, adaptive.thrust)
    plan = adaptive.replanner.plan(tables, sweeps=TO_THE_END)
    route = plan.route(task.start, task.step)
    arrives = bool(jnp.isfinite(route.arrival_time))
    way = np.asarray(route.ys, float)[:, :2]
    if not arrives:
        assert isinstance(task.objective, ReachGoal)
        ends = np.asarray(task.start[:2], float), np.asarray(task.objective.goal, float)
        way = np.linspace(*ends, WAY_POINTS)
    way = _equally_spaced(way)
    forces = belief.samples_at(way, DRAWS, seed=belief.count)
    mean, _ = belief.force(way)
    gaps = np.linalg.norm((forces - mean).reshape(DRAWS, -1), axis=1)
    sizes = np.linalg.norm(forces.reshape(DRAWS, -1), axis=1)
    truth = true_force(task, way)
    size = np.linalg.norm(truth)
    return Decision(
        way,
        arrives,
        float(np.quantile(gaps / np.maximum(sizes, 1e-300), CONFIDENCE)),
        float(np.linalg.norm(mean - truth) / size) if size > 0 else math.nan,
    )


def _equally_spaced(points: Way) -> Float[np.ndarray, "way 2"]:
    """Points of equal distance along a path."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    asked = np.linspace(0.0, along[-1], WAY_POINTS)
    return np.stack([np.interp(asked, along, axis) for axis in points.T], axis=1)


SPEED = 2.0
"""Standard deviation of the first velocity, over the mean speed of a trajectory."""


def believe_data(
    adaptive: AdaptiveController,
    swimmer: AbstractSwimmer,
    data: Trajectories,
    position_noise: float,
) -> Belief:
    """The belief on the force after recorded trajectories.

    Args:
        swimmer: whose propulsion drove the trajectories, by their commands where it
            takes any.
        position_noise: standard deviation of each coordinate [L].

    Raises:
        InputError: a trajectory has fewer than two observed positions.
    """
    belief: Belief | None = None
    for number, piece in enumerate(data):
        frames = list(frames_of(swimmer, piece, position_noise))
        if len(frames) < 2:
            raise InputError(
                f"data: trajectory {number} has fewer than two observed positions; "
                "leave it out"
            )
        places = [f.position for f in frames if f.position is not None]
        moved = np.linalg.norm(np.diff(np.stack(places), axis=0), axis=1)
        speed = SPEED * float(np.sum(moved)) / (frames[-1].time - frames[0].time)
        sd = max(speed, adaptive.rest_sd(frames[0]))
        if belief is None:
            belief = adaptive.believe(frames[0])
        belief = learn(adaptive, belief, frames, sd)
    assert belief is not None
    return belief


def frames_of(
    swimmer: AbstractSwimmer, piece: Trajectory, position_noise: float
) -> Iterator[Frame]:
    """The observed positions of a trajectory, with the thrust before each."""
    driven = drive_by_arrays(swimmer, piece.times, piece.commands)
    seen = np.flatnonzero(piece.observed[:, :2].all(axis=1))
    last = None
    for k in seen:
        time, position = float(piece.times[k]), piece.states[k, :2]
        thrust = np.zeros(2)
        if last is not None:
            middle = jnp.asarray((last + time) / 2)
            x = jnp.asarray(position)
            thrust = np.asarray(driven.propulsion(middle, x, jnp.zeros_like(x)), float)
        yield Frame(time, position, position_noise, thrust)
        last = time


@dataclasses.dataclass(frozen=True)
class CampaignSummary:
    """Campaigns of one design in a simulation.

    Attributes:
        finished: campaigns in which the way became known by the belief.
        trajectories: median number of trajectories until then; infinite where more than
            half did not finish.
        largest: greatest number of a campaign; those that were given up count, too.
        reached: median number of trajectories until the true error was below the
            accuracy for the first time; infinite where more than half did not get
            there.
        right: finished campaigns whose true error was below the accuracy.
        error: median of the true relative error at the end.
    """

    campaigns: int
    finished: int
    trajectories: float
    fewest: int
    largest: int
    reached: float
    right: int
    error: float

    @classmethod
    def of(cls, campaigns: Sequence[Campaign]) -> "CampaignSummary":
        """The summary of the campaigns of one design."""
        counts = np.array([len(one.paths) for one in campaigns])
        finished = np.array([one.finished for one in campaigns])
        ends = np.where(finished, counts, np.inf)
        reached = np.array([_first_below(one) for one in campaigns])
        errors = np.array([one.decisions[-1].true_error for one in campaigns], float)
        return cls(
            campaigns=len(campaigns),
            finished=int(finished.sum()),
            trajectories=quantiles(ends).median,
            fewest=int(counts.min()),
            largest=int(counts.max()),
            reached=quantiles(reached).median,
            right=sum(one.right is True for one in campaigns),
            error=quantiles(errors).median,
        )


@dataclasses.dataclass(frozen=True, eq=False)
class DesignResult:
    """Trajectories until the force along a way is known.

    Attributes:
        accuracy: relative error of the force along the way that is small enough.
        maps: learned force after the first campaign, or the recordings.
        paths: trajectories of the first campaign of each design, or the recordings [L].
        designs: simulated campaigns by the name of their design.
        bounds: bound of the error after each trajectory, by design and campaign.
        next: trajectory to record next; none where no candidate stays in the arena, or
            of a simulation.
    """

    system: str
    accuracy: float
    course: Course
    maps: ForceMaps
    decision: Decision
    thrust: float
    paths: dict[str, tuple[Float[np.ndarray, "_ 2"], ...]]
    designs: dict[str, CampaignSummary] = dataclasses.field(default_factory=dict)
    bounds: dict[str, tuple[Float[np.ndarray, " _"], ...]] = dataclasses.field(
        default_factory=dict
    )
    next: candidates.Suggestion | None = None


def _first_below(campaign: Campaign) -> float:
    for count, decision in enumerate(campaign.decisions):
        error = decision.true_error
        if decision.arrives and error is not None and error <= campaign.accuracy:
            return float(count)
    return np.inf
