"""Choices of the next trajectory of a campaign."""

import abc
import dataclasses
import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from pinav.errors import InputError
from pinav.navigation.adaptive.known import known_rate
from pinav.navigation.adaptive.steering import AdaptiveController
from pinav.navigation.belief.belief import SETTLE_EVERY, Belief
from pinav.navigation.design.candidates import CandidateTrajectories, Experiment
from pinav.navigation.design.information import best_candidate
from pinav.navigation.task.steering import AbstractActuator
from pinav.navigation.task.task import Task, clearance

COARSE = 2
"""Control steps that are taken at once where a candidate is only imagined."""

Way = Float[np.ndarray, "point 2"]


@dataclasses.dataclass(frozen=True, eq=False)
class Stage:
    """The state of a campaign.

    Attributes:
        way: along which the force matters [L].
        count: trajectories so far.
    """

    adaptive: AdaptiveController
    experiment: Experiment
    belief: Belief
    way: Way
    count: int = 0


class AbstractDesign(eqx.Module):
    """Chooses what is recorded next."""

    @abc.abstractmethod
    def choose(self, stage: Stage, *, key: PRNGKeyArray) -> CandidateTrajectories:
        """The next trajectory, a single one."""


class RandomDesign(AbstractDesign):
    """Random starts and random programmes."""

    def choose(self, stage: Stage, *, key: PRNGKeyArray) -> CandidateTrajectories:
        drawn = stage.experiment.draw(64, key=key)
        return _keep_allowed(stage.adaptive.task, drawn)[0]


class GridDesign(AbstractDesign):
    """Straight drives at the greatest frequency, starts and headings evenly spread.

    Places and headings are those of the Halton sequence in the bases 2, 3 and 5, which
    fills the region evenly after any number of trajectories.

    References:
        Halton, Numer. Math. 2, 84 (1960).
    """

    def choose(self, stage: Stage, *, key: PRNGKeyArray) -> CandidateTrajectories:
        from scipy.stats import qmc  # half a second that other designs do without

        sequence = qmc.Halton(3, scramble=False)
        shares = sequence.fast_forward(1).random(512)  # its first point is a corner
        experiment = stage.experiment
        region = experiment.region
        lower, upper = np.asarray(region.lower), np.asarray(region.upper)
        places = lower + shares[:, :2] * (upper - lower)
        shape = (len(shares), len(experiment.knots))
        all_of_them = CandidateTrajectories(
            jnp.asarray(np.pad(places, ((0, 0), (0, len(experiment.noise) - 2)))),
            jnp.full(shape, experiment.limits.max_frequency),
            jnp.broadcast_to(2 * math.pi * jnp.asarray(shares[:, 2:]), shape),
        )
        allowed = _keep_allowed(stage.adaptive.task, all_of_them)
        return allowed[stage.count % len(allowed.starts)]


class InformedDesign(AbstractDesign):
    """The candidate after which the force along the way should be known best.

    A candidate is imagined: the filter that leads moves along it and observes what it
    expects, which leaves its mean and lowers its covariance. Half of the candidates are
    released on the way and begin along it, if they may be released there. The best one
    is varied in further rounds.
    """

    candidates: int = eqx.field(static=True, default=24)
    variations: int = eqx.field(static=True, default=8)
    rounds: int = eqx.field(static=True, default=2)

    def choose(self, stage: Stage, *, key: PRNGKeyArray) -> CandidateTrajectories:
        experiment = stage.experiment
        keys = jax.random.split(key, self.rounds + 2)
        drawn = experiment.draw(4 * self.candidates, key=keys[0])
        along = _along(stage.way, drawn, experiment, keys[1])
        half = self.candidates // 2
        others = _keep_allowed(stage.adaptive.task, drawn)
        best, _ = best_candidate(
            functools.partial(expected_sd, stage),
            experiment,
            _join(along[:half], others[:half]),
            variations=self.variations,
            keys=list(keys[2:]),
        )
        return best


def expected_sd(stage: Stage, candidate: CandidateTrajectories) -> float:
    """Standard deviation of the force along a way that is expected after a candidate.

    Infinite where the candidate should enter something forbidden.
    """
    adaptive, experiment, task = stage.adaptive, stage.experiment, stage.adaptive.task
    step = COARSE * task.step
    moments = np.arange(round(experiment.duration / step)) * step
    series = (candidate.frequency, candidate.heading)
    knots = np.asarray(experiment.knots)
    commands = [np.interp(moments + step / 2, knots, np.asarray(s)) for s in series]
    thrusts = _thrusts(task.truth.actuator, jnp.asarray(np.stack(commands, axis=1)))
    sd = task.position_sd / math.sqrt(COARSE)
    place = np.asarray(candidate.starts[:2], float)
    one = stage.belief.best
    one = one.restart(*one.motion.start(place, sd, sd))
    path = [place]
    for k, thrust in enumerate(np.asarray(thrusts, float)):
        rate = known_rate(one, thrust, step, adaptive.physics)
        one = one.predict(rate, step)
        one = one.update(one.state[:2], sd)
        if k % SETTLE_EVERY == SETTLE_EVERY - 1:
            one = one.settle()
        path.append(one.state[:2])
    if float(_least_clearance(task, jnp.asarray(np.stack(path)))) < 0:
        return math.inf
    _, spread = one.force(stage.way)
    return float(np.sqrt(np.mean(spread**2)))


def _along(
    way: Way,
    drawn: CandidateTrajectories,
    experiment: Experiment,
    key: PRNGKeyArray,
) -> CandidateTrajectories:
    """Random programmes, released on the way and turned along it."""
    count = len(drawn.starts)
    chosen = np.asarray(jax.random.randint(key, (count,), 0, len(way) // 2))
    region = experiment.region
    inside = np.all(
        (way >= np.asarray(region.lower)) & (way <= np.asarray(region.upper)), axis=1
    )
    places = np.asarray(drawn.starts).copy()
    places[:, :2] = np.where(inside[chosen][:, None], way[chosen], places[:, :2])
    ahead = way[np.minimum(chosen + 1, len(way) - 1)] - way[chosen]
    first = jnp.asarray(np.arctan2(ahead[:, 1], ahead[:, 0]))
    heading = drawn.heading - drawn.heading[:, :1] + first[:, None]
    return CandidateTrajectories(jnp.asarray(places), drawn.frequency, heading)


def _join(*parts: CandidateTrajectories) -> CandidateTrajectories:
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)


def _keep_allowed(
    task: Task, candidates: CandidateTrajectories
) -> CandidateTrajectories:
    """Candidates that are not released in something forbidden.

    Raises:
        InputError: all of them are.
    """
    room = jax.vmap(lambda x: clearance(x, task.keep_out, task.arena))(
        candidates.starts[:, :2]
    )
    free = np.flatnonzero(np.asarray(room) > 0)
    if not len(free):
        raise InputError(
            "release: expected a place outside of what must not be entered, found none "
            f"among {len(room)}; state a larger rectangle"
        )
    return candidates[free]


@eqx.filter_jit
def _thrusts(
    actuator: AbstractActuator, commands: Float[Array, "time 2"]
) -> Float[Array, "time 2"]:
    return jax.vmap(actuator)(commands)


@eqx.filter_jit
def _least_clearance(task: Task, path: Float[Array, "time 2"]) -> Float[Array, ""]:
    return jnp.min(jax.vmap(lambda x: clearance(x, task.keep_out, task.arena))(path))
