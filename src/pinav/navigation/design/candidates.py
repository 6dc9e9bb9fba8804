r"""Candidates for the next recording, within the limits, and choices among them.

A candidate is worth what it leaves unknown: the standard deviation of the force along
the way that is expected after it, by the filter that leads.

References:
    MacKay, Neural Computation 4, 590 (1992); Chaloner and Verdinelli, Statistical
    Science 10, 273 (1995).
"""

import abc
import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int, PRNGKeyArray

from pinav.arguments import check_positive
from pinav.errors import InputError
from pinav.navigation.adaptive.steering import AdaptiveController
from pinav.navigation.adaptive.strategies import known_rate
from pinav.navigation.belief.belief import SETTLE_EVERY, Belief
from pinav.navigation.belief.kernel_filter import KernelFilter
from pinav.navigation.task.steering import thrusts_of
from pinav.navigation.task.task import Rectangle, Task


class CandidateTrajectories(eqx.Module):
    """Trajectories that could be recorded, as a batch.

    Attributes:
        frequency: commanded at each knot [cycles T⁻¹].
        heading: commanded at each knot [rad].
    """

    starts: Float[Array, "*candidate state"]
    frequency: Float[Array, "*candidate knot"]
    heading: Float[Array, "*candidate knot"]

    def __getitem__(
        self, index: int | slice | Int[ArrayLike, " chosen"]
    ) -> "CandidateTrajectories":
        """One candidate, or some of them."""
        return jax.tree.map(lambda leaf: leaf[index], self)


KNOTS = 8
"""Changes of the command in a trajectory, unless its steps are longer."""

SPREAD = 0.3
"""Changes of a variation, relative to those between random candidates."""

TURN = 1.2
"""Standard deviation of the change of heading between two commands [rad]."""


class Experiment(eqx.Module):
    """The recording of trajectories of a task's swimmer, and its limits.

    The swimmer is released at rest and observed at every step of the task. Commands are
    given at knots and go linearly from one to the next, so that the heading never
    jumps. Candidates are random: the first heading is uniform, later ones follow a
    random walk; frequencies are uniform up to their limit.

    Attributes:
        task: the swimmer, the limits of its commands, and the error of the sensor.
        duration: of a trajectory [T], positive.
    """

    task: Task
    region: Rectangle
    duration: float = eqx.field(static=True)

    def __check_init__(self) -> None:
        check_positive(self, "duration")

    @property
    def knot(self) -> float:
        """Time between two commands [T]."""
        return max(self.duration / KNOTS, self.task.step)

    @property
    def knots(self) -> Float[Array, " knot"]:
        """Times of the commands from the start [T]."""
        count = max(round(self.duration / self.knot), 1)
        return jnp.linspace(0.0, self.duration, count + 1)

    def commands(
        self, candidate: CandidateTrajectories, moments: Float[np.ndarray, " time"]
    ) -> Float[Array, "time 2"]:
        """Frequency and heading of a single candidate at some moments [T]."""
        knots = np.asarray(self.knots)
        series = (candidate.frequency, candidate.heading)
        parts = [np.interp(moments, knots, np.asarray(values)) for values in series]
        return jnp.asarray(np.stack(parts, axis=1))

    @eqx.filter_jit
    def draw(self, count: int, *, key: PRNGKeyArray) -> CandidateTrajectories:
        """Random candidates: released at rest, uniformly in the region."""
        place_key, first_key, turn_key, frequency_key = jax.random.split(key, 4)
        lower, upper = self.region.lower, self.region.upper
        fraction = jax.random.uniform(place_key, (count, 2))
        places = lower[None] + fraction * (upper - lower)[None]
        rest = jnp.zeros((count, len(self.task.start) - 2))
        first = jax.random.uniform(first_key, (count, 1), maxval=2 * np.pi)
        steps = len(self.knots) - 1
        turns = jax.random.normal(turn_key, (count, steps)) * TURN
        walk = jnp.cumsum(self._clip_turns(turns), axis=1)
        return CandidateTrajectories(
            starts=jnp.concatenate([places, rest], axis=1),
            frequency=jax.random.uniform(
                frequency_key, (count, steps + 1), maxval=self.task.limits.max_frequency
            ),
            heading=jnp.concatenate([first, first + walk], axis=1),
        )

    @eqx.filter_jit
    def vary(
        self, candidate: CandidateTrajectories, count: int, *, key: PRNGKeyArray
    ) -> CandidateTrajectories:
        """Variations of a trajectory, within the same limits, from the same start."""
        first_key, turn_key, frequency_key = jax.random.split(key, 3)
        turns = jnp.diff(candidate.heading)
        changes = jax.random.normal(turn_key, (count, len(turns))) * TURN
        first = jax.random.normal(first_key, (count, 1)) * np.pi * SPREAD
        walk = jnp.cumsum(self._clip_turns(turns[None] + SPREAD * changes), axis=1)
        heading = candidate.heading[0] + first
        scatter = jax.random.normal(frequency_key, (count, len(turns) + 1))
        most = self.task.limits.max_frequency
        frequency = candidate.frequency[None] + SPREAD * most * scatter
        return CandidateTrajectories(
            starts=jnp.broadcast_to(candidate.starts, (count, *candidate.starts.shape)),
            frequency=jnp.clip(frequency, 0.0, most),
            heading=jnp.concatenate([heading, heading + walk], axis=1),
        )

    def _clip_turns(
        self, turns: Float[Array, "candidate step"]
    ) -> Float[Array, "candidate step"]:
        """Changes of heading that the coils can follow, less than half a turn."""
        most = min(self.task.limits.max_turning_rate * self.knot, 0.99 * np.pi)
        return jnp.clip(turns, -most, most)


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
            jnp.asarray(np.pad(places, ((0, 0), (0, len(experiment.task.start) - 2)))),
            jnp.full(shape, experiment.task.limits.max_frequency),
            jnp.broadcast_to(2 * math.pi * jnp.asarray(shares[:, 2:]), shape),
        )
        allowed = _keep_allowed(stage.adaptive.task, all_of_them)
        return allowed[stage.count % len(allowed.starts)]


class InformedDesign(AbstractDesign):
    """The candidate after which the force along the way should be known best.

    Half of the candidates are released on the way and begin along it, if they may be
    released there. The best one is varied in further rounds.
    """

    candidates: int = eqx.field(static=True, default=24)
    variations: int = eqx.field(static=True, default=8)
    rounds: int = eqx.field(static=True, default=2)

    def choose(self, stage: Stage, *, key: PRNGKeyArray) -> CandidateTrajectories:
        return self.best(stage, key=key)[0]

    def best(
        self, stage: Stage, *, key: PRNGKeyArray
    ) -> tuple[CandidateTrajectories, float]:
        """The choice, and the standard deviation that is expected after it."""
        experiment = stage.experiment
        keys = jax.random.split(key, self.rounds + 2)
        drawn = experiment.draw(4 * self.candidates, key=keys[0])
        along = _along(stage.way, drawn, experiment, keys[1])
        half = self.candidates // 2
        others = _keep_allowed(stage.adaptive.task, drawn)
        tried = jax.tree.map(
            lambda *leaves: jnp.concatenate(leaves), along[:half], others[:half]
        )
        best, least = _best(stage, tried)
        for round_key in keys[2:]:
            varied = experiment.vary(best, self.variations, key=round_key)
            other, sd = _best(stage, varied)
            if sd < least:
                best, least = other, sd
        return best, least


def _best(
    stage: Stage, candidates: CandidateTrajectories
) -> tuple[CandidateTrajectories, float]:
    """The candidate of the smallest expected standard deviation, and that."""
    every = [candidates[k] for k in range(len(candidates.starts))]
    sds = [expected_sd(stage, candidate) for candidate in every]
    best = int(np.argmin(sds))
    return every[best], sds[best]


def expected_sd(stage: Stage, candidate: CandidateTrajectories) -> float:
    """Standard deviation of the force along a way that is expected after a candidate.

    Infinite where the candidate should enter something forbidden.
    """
    later, path = imagine(stage, candidate)
    if float(_least_clearance(stage.adaptive.task, jnp.asarray(path))) < 0:
        return math.inf
    return _spread(later.force(stage.way)[1])


def imagine(
    stage: Stage, candidate: CandidateTrajectories
) -> tuple[KernelFilter, Float[np.ndarray, "time 2"]]:
    """The filter that leads after a candidate, and the positions that it expects [L].

    It moves along the candidate and observes what it expects, which leaves its mean
    and lowers its covariance.
    """
    adaptive, experiment, task = stage.adaptive, stage.experiment, stage.adaptive.task
    step = COARSE * task.step
    moments = np.arange(round(experiment.duration / step)) * step
    commands = experiment.commands(candidate, moments + step / 2)
    thrusts = thrusts_of(task.truth.actuator, commands)
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
    return one, np.stack(path)


def _spread(sd: Float[np.ndarray, "point 2"]) -> float:
    """Root mean square of standard deviations along a way."""
    return float(np.sqrt(np.mean(sd**2)))


@dataclasses.dataclass(frozen=True, eq=False)
class Suggestion:
    """The trajectory that should be recorded next.

    Attributes:
        sd: standard deviation of the force along the way now.
        sd_after: the same, expected after the trajectory.
        start: place of release [L].
        times: times of the commands, the last one at the end [T].
        frequency: commanded frequency then [cycles T⁻¹].
        heading: commanded heading then [rad].
        sd_after_random: as `sd_after`, the median of random trajectories; none where
            all of these leave the arena.
        path: predicted positions [L].
    """

    sd: float
    sd_after: float
    start: tuple[float, float]
    times: Float[np.ndarray, " knot"]
    frequency: Float[np.ndarray, " knot"]
    heading: Float[np.ndarray, " knot"]
    sd_after_random: float | None = None
    path: Float[np.ndarray, "sample 2"] | None = None

    def scale(self, factor: float) -> "Suggestion":
        """The same with standard deviations in another unit."""
        random = self.sd_after_random
        return dataclasses.replace(
            self,
            sd=factor * self.sd,
            sd_after=factor * self.sd_after,
            sd_after_random=None if random is None else factor * random,
        )


RANDOM = 12
"""Random trajectories beside which a suggestion is put."""


def suggest_next(stage: Stage, *, key: PRNGKeyArray) -> Suggestion | None:
    """The choice of the informed design; none where all leave the arena."""
    chosen, after = InformedDesign().best(stage, key=key)
    if not np.isfinite(after):
        return None
    keys = jax.random.split(jax.random.fold_in(key, 1), RANDOM)
    random = [RandomDesign().choose(stage, key=one) for one in keys]
    sds = np.array([expected_sd(stage, one) for one in random])
    inside = np.isfinite(sds)
    x, y = np.asarray(chosen.starts[:2], float).tolist()
    series = stage.experiment.knots, chosen.frequency, chosen.heading
    return Suggestion(
        _spread(stage.belief.force(stage.way)[1]),
        after,
        (x, y),
        *(np.asarray(values, float) for values in series),
        sd_after_random=float(np.median(sds[inside])) if inside.any() else None,
        path=imagine(stage, chosen)[1],
    )


def _along(
    way: Way, drawn: CandidateTrajectories, experiment: Experiment, key: PRNGKeyArray
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


def _keep_allowed(
    task: Task, candidates: CandidateTrajectories
) -> CandidateTrajectories:
    """Candidates that are not released in something forbidden."""
    room = jax.vmap(task.clearance)(candidates.starts[:, :2])
    free = np.flatnonzero(np.asarray(room) > 0)
    if not len(free):
        raise InputError(
            "release: expected a place outside of what must not be entered, found none "
            f"among {len(room)}; state a larger rectangle"
        )
    return candidates[free]


@eqx.filter_jit
def _least_clearance(task: Task, path: Float[Array, "time 2"]) -> Float[Array, ""]:
    return jnp.min(jax.vmap(task.clearance)(path))
