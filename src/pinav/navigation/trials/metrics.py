"""Metrics of episodes, with intervals."""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import binom, binomtest

from pinav.errors import InputError
from pinav.navigation.task.steering import direction
from pinav.navigation.task.task import FollowPath, Task
from pinav.navigation.trials.closed_loop import Episodes


class Interval(eqx.Module):
    """A value with its 95 % confidence interval."""

    value: float
    lower: float
    upper: float


class Quantiles(NamedTuple):
    """Quantiles of some values; not a number where there are none.

    Attributes:
        low: 5 % quantile.
        high: 95 % quantile.
    """

    low: float
    median: float
    high: float


class Summary(eqx.Module):
    """Metrics of the episodes of a task.

    Quantiles do not interpolate. What nobody achieved is not a number.

    Attributes:
        success: fraction that did the task without a violation: reached the goal, or
            followed the path until the time was up.
        violation: fraction that entered a forbidden place.
        efficiency: straight distance / length of the way, mean of those that arrived.
        tracking: mean distance from the target, averaged over episodes [L]; of paths.
        tracking_rms: root mean square of that distance [L].
        clearance: least of all episodes [L].
        effort: mean of the integral of the squared frequency [cycles² T⁻¹].
        turning: mean sum of the changes of heading [rad].
    """

    runs: int
    success: Interval
    violation: Interval
    arrival: Quantiles
    efficiency: float
    tracking: float
    tracking_rms: float
    clearance: float
    effort: float
    turning: float


def summary(episodes: Episodes, task: Task) -> Summary:
    """Metrics of the episodes of a task."""
    count = len(episodes.steps)
    follows = isinstance(task.objective, FollowPath)
    done = ~episodes.violated if follows else episodes.reached
    arrived = episodes.arrival_time[episodes.reached]
    during = _within_episode(episodes, episodes.commands.shape[1])
    power = np.where(during, episodes.commands[..., 0] ** 2, 0.0)
    efficiencies = _efficiencies(episodes, task)[episodes.reached]
    nothing = np.full(count, np.nan)
    tracking, squares = (
        tracking_errors(episodes, task, power=exponent) if follows else nothing
        for exponent in (1, 2)
    )
    return Summary(
        runs=count,
        success=proportion(int(done.sum()), count),
        violation=proportion(int(episodes.violated.sum()), count),
        arrival=quantiles(arrived),
        efficiency=float(np.mean(efficiencies)) if len(efficiencies) else math.nan,
        tracking=float(np.mean(tracking)),
        tracking_rms=float(np.sqrt(np.mean(squares))),
        clearance=float(np.min(episodes.clearance)),
        effort=float(np.mean(task.step * np.sum(power, axis=1))),
        turning=float(np.mean(_turnings(episodes))),
    )


def proportion(successes: int, count: int) -> Interval:
    r"""A proportion with its 95 % score interval.

    Raises:
        InputError: the numbers are not those of a proportion.

    References:
        Wilson, J. Am. Stat. Assoc. 22, 209 (1927).
    """
    if not 0 <= successes <= count or count < 1:
        raise InputError(
            "proportion: expected 0 <= successes <= count and count >= 1, got "
            f"{successes} of {count}"
        )
    interval = binomtest(successes, count).proportion_ci(method="wilson")
    return Interval(successes / count, float(interval.low), float(interval.high))


def regret(learned: Episodes, oracle: Episodes) -> Interval:
    """Median of arrival time with the learned model / with the true one, in pairs.

    A learned model that does not arrive has an infinite ratio: failures are not left
    out. Pairs in which the oracle does not arrive are. The interval is between order
    statistics, right whatever the distribution.

    Raises:
        InputError: the numbers of episodes differ, or the oracle never arrived.
    """
    if len(learned.steps) != len(oracle.steps):
        raise InputError(
            f"regret: expected as many episodes of both, got {len(learned.steps)} and "
            f"{len(oracle.steps)}; run both with the same keys"
        )
    pairs = oracle.reached
    if not pairs.any():
        raise InputError(
            "regret: the oracle never arrived, so that there is no time to compare "
            "with; give the task more time"
        )
    return median(learned.arrival_time[pairs] / oracle.arrival_time[pairs])


def median(values: Float[np.ndarray, " value"]) -> Interval:
    """Median, and an interval between order statistics that holds it with 95 %."""
    ordered, count = np.sort(values), len(values)
    below = int(binom.ppf(0.025, count, 0.5))
    ends = max(below - 1, 0), min(count - below, count - 1)
    middle = float(np.quantile(ordered, 0.5, method="inverted_cdf"))
    return Interval(middle, float(ordered[ends[0]]), float(ordered[ends[1]]))


def quantiles(values: Float[np.ndarray, " value"]) -> Quantiles:
    """Quantiles of values, without interpolation."""
    if not len(values):
        return Quantiles(math.nan, math.nan, math.nan)
    parts = np.quantile(values, [0.05, 0.5, 0.95], method="inverted_cdf")
    return Quantiles(*(float(part) for part in parts))


def tracking_errors(
    episodes: Episodes, task: Task, *, power: int = 1
) -> Float[np.ndarray, " episode"]:
    """Mean of the distance from the target [L], to a power, of each episode."""
    targets = np.asarray(jax.vmap(task.objective.target)(jnp.asarray(episodes.ts)))
    distances = np.linalg.norm(
        episodes.states[..., : task.dim] - targets[None], axis=-1
    )
    during = _within_episode(episodes, len(episodes.ts), offset=1)
    return np.mean(distances**power, axis=1, where=during)


def _efficiencies(episodes: Episodes, task: Task) -> Float[np.ndarray, " episode"]:
    """Straight distance over the length of the way."""
    steps = np.diff(episodes.states[..., : task.dim], axis=1)
    lengths = np.sum(np.linalg.norm(steps, axis=-1), axis=1)
    straight = np.linalg.norm(
        episodes.states[:, -1, : task.dim] - np.asarray(task.start)[None, : task.dim],
        axis=1,
    )
    return straight / np.maximum(lengths, np.finfo(float).tiny)


def _turnings(episodes: Episodes) -> Float[np.ndarray, " episode"]:
    ahead = jax.vmap(jax.vmap(direction))(jnp.asarray(episodes.commands[..., 1:]))
    cosines = np.sum(np.asarray(ahead[:, 1:] * ahead[:, :-1]), axis=-1)
    turns = np.arccos(np.clip(cosines, -1.0, 1.0))
    during = _within_episode(episodes, turns.shape[1], offset=-1)
    return np.sum(np.where(during, turns, 0.0), axis=1)


def _within_episode(
    episodes: Episodes, count: int, offset: int = 0
) -> Bool[np.ndarray, "episode step"]:
    """True for entries of the episode, before its end."""
    return np.arange(count)[None] < episodes.steps[:, None] + offset
